"""A gRPC connection whose calls end in time; knows nothing of NI."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


class Bounded:
    """A gRPC connection of its own whose calls end in time; nothing is sent twice."""

    def __init__(self, server: str, left: Callable[[], float]) -> None:
        import grpc

        options = {
            "grpc.enable_http_proxy": 0,
            "grpc.enable_retries": 0,
            "grpc.use_local_subchannel_pool": 1,
            "grpc.initial_reconnect_backoff_ms": 100,
            "grpc.min_reconnect_backoff_ms": 500,
            "grpc.max_reconnect_backoff_ms": 500,
        }
        self._channel, self._left = grpc.insecure_channel(server, list(options.items())), left

    def unary_unary(self, *names: Any, **how: Any) -> Callable[..., Any]:
        """One question and one answer."""
        call = self._channel.unary_unary(*names, **how)

        def bounded(request: Any, metadata: Any = None) -> Any:
            return call(request, timeout=self._left(), metadata=metadata)

        return bounded

    def __getattr__(self, name: str) -> Any:
        return getattr(self._channel, name)
