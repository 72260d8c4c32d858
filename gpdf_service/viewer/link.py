"""The page's connection to a service: found, lost, found again; nobody waits for it."""

from __future__ import annotations

import threading
from collections.abc import Callable

import zenoh
from gpdf_client import Client, UnavailableError

TRY_S = 1.0
"""[s] One try to connect; between tries the page may be closed."""


class Link:
    """Looks for a service until it is there, then hears from Zenoh when it goes and comes back.

    Args:
        endpoint: Where the service listens.
        on_change: Told whether a service is there, each time that this changes or another one answers.
        config: Zenoh's, with credentials; it names the endpoint, too.
    """

    def __init__(self, endpoint: str, on_change: Callable[[bool], None], config: zenoh.Config | None = None) -> None:
        self.endpoint = endpoint if config is None else config.get_json("connect/endpoints")
        self._on_change, self._config = on_change, config
        self._services: set[str] = set()
        self._client: Client | None = None
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._look, name="gpdf-link", daemon=True)

    def start(self) -> None:
        """Begin to look."""
        self._thread.start()

    @property
    def client(self) -> Client:
        """The client, while a service is there.

        Raises:
            UnavailableError: none is.
        """
        client = self._client
        if client is None or not self._services:
            raise UnavailableError(f"There is no service at {self.endpoint}. Start one: gpdf serve …")
        return client

    def close(self) -> None:
        """Stop looking and end the connection."""
        self._closing.set()
        self._thread.join()
        if self._client is not None:
            self._client.close()

    def _look(self) -> None:
        while not self._closing.is_set():
            try:
                self._client = Client.connect(self.endpoint, timeout_s=TRY_S, config=self._config)
            except UnavailableError:
                continue
            self._client.watch(self._hear)
            return

    def _hear(self, service: str, there: bool) -> None:
        (self._services.add if there else self._services.discard)(service)
        self._on_change(bool(self._services))
