"""The service's status for Prometheus, at http://127.0.0.1:PORT/metrics."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from gpdf_schemas import StatusReply
from prometheus_client import CollectorRegistry, start_http_server
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric

from gpdf_service.errors import ConfigError

HOST = "127.0.0.1"
"""It has no login: who wants it elsewhere puts a proxy or an agent on this machine."""
ANSWERS = "answers_"
"""What the number of answers of one status begins with, among the metrics."""
COUNTED = ("messages_lost", "bad_publications", "process_restarts")
"""Numbers that only rise."""


class Endpoint:
    """Serves what `status` says at the moment that it is asked; `close` it.

    Args:
        port: To listen on, on this machine alone.
        status: The service's status now.

    Raises:
        ConfigError: the port cannot be had.
    """

    def __init__(self, port: int, status: Callable[[], StatusReply]) -> None:
        registry = CollectorRegistry()
        registry.register(_Collector(status))
        try:
            self._server, self._thread = start_http_server(port, HOST, registry)
        except OSError as error:
            raise ConfigError("serve.metrics_port", f"{port}: {error}", "Give a free port.") from error

    def close(self) -> None:
        """Listen no more."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class _Collector:
    def __init__(self, status: Callable[[], StatusReply]) -> None:
        self._status = status

    def collect(self) -> Iterator[Metric]:
        """One family a number; answers are one family with their status as a label."""
        status = self._status()
        answers = CounterMetricFamily("gpdf_answers", "Answers by status.", labels=["status"])
        for name, value in status.metrics.items():
            if name.startswith(ANSWERS):
                answers.add_metric([name.removeprefix(ANSWERS)], value)
            else:
                family = CounterMetricFamily if name in COUNTED else GaugeMetricFamily
                yield family(f"gpdf_{name}", f"See {name} in the status over Zenoh.", value=value)
        yield answers
        yield GaugeMetricFamily("gpdf_healthy", "1 if it does its work.", value=status.healthy)
        yield GaugeMetricFamily("gpdf_ready", "1 if it can be asked.", value=status.ready)
        yield GaugeMetricFamily("gpdf_problems", "Things that are wrong.", value=len(status.problems))
