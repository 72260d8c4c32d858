"""Ask a running service for a plan and look at the answer.  Usage: python plan.py [ENDPOINT]."""

import sys

from gpdf_client import Client, Status

endpoint = sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7447"
with Client.connect(endpoint) as client:
    result = client.plan("office", start=(1, 1), goal=(5, 3.3), agent="human")
    print(result.status, result.message)
    if result.status is Status.OK:
        path = result.trajectory
        print(f"{path.length:.2f} m in {path.duration:.1f} s, {len(path.times)} waypoints")
        print(f"at least {result.certificate.min_clearance:.2f} m of room, everywhere on the way")
