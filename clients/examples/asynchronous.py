"""Four plans at once with asyncio.  Usage: python asynchronous.py [ENDPOINT]."""

import asyncio
import sys

from gpdf_client import AsyncClient

endpoint = sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7447"


async def main() -> None:
    async with await AsyncClient.connect(endpoint) as client:
        await client.wait_for_scene("office", timeout_s=60)
        agents = ("roomba", "spot", "pepper", "human")
        results = await asyncio.gather(*(client.plan("office", (0.9, 0.9), (5.4, 3.4), name) for name in agents))
        for name, result in zip(agents, results, strict=True):
            print(name, result.status)


asyncio.run(main())
