"""Requests of browsers: access control, the page, streams of new data, history, and the vent button.

Every answer except the page needs the token. The page itself contains no data, and the token is in the fragment of its
address, which browsers do not send. A request by another host name (DNS rebinding), or from a page of another origin,
is refused.
"""

from __future__ import annotations

import base64
import gzip
import hashlib
import hmac
import ipaddress
import json
import re
import socket
import subprocess
import sys
import threading
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

from pmabench.display.web.feeds import Feed, Room, Seen

SCRIPTS = ("text.js", "curves.js", "figures.js", "parts.js", "link.js", "main.js")
"""Files of the script in `page/`, in order."""
NOT_SHOWN = r"\.u-(legend|inline|series|title)\b[^{}]*\{[^{}]*\}"
"""Rules of uPlot's style for legend and title, which no plot of this page has."""


def _read(package: str, name: str) -> str:
    return files(package).joinpath(name).read_text("utf-8")


def _short(text: str) -> str:
    """Script or markup without indentation and full-line comments, to reduce its size."""
    lines = (line.strip() for line in text.splitlines())
    return "\n".join(line for line in lines if line and not line.startswith("//"))


def _hash(text: str) -> str:
    return "'sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() + "'"


@cache
def page() -> tuple[bytes, str]:
    """The page, and its Content-Security-Policy: its own script and style, data of the same address, nothing else."""
    vendored, own = "pmabench.plotting", "pmabench.display.web"
    style = re.sub(NOT_SHOWN, "", _read(vendored, "web/uplot.min.css"))
    style += "".join(_read(own, "page/page.css").splitlines())
    parts = "\n".join(_short(_read(own, f"page/{name}")) for name in SCRIPTS)
    script = f"{_read(vendored, 'web/uplot.iife.min.js')}\n(() => {{'use strict';\n{parts}\n}})()"
    text = _short(_read(own, "page/page.html")).replace("<style></style>", f"<style>{style}</style>")
    text = text.replace("<script></script>", f"<script>{script}</script>")
    policy = (
        f"default-src 'none'; script-src {_hash(script)}; style-src {_hash(style)}; connect-src 'self'; "
        "img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
    return text.encode(), policy


LONGEST_WAIT = 20.0
"""Idle time after which a connection is closed [s]."""
MOST_CONNECTIONS = 48
MOST_STREAMS = 4
"""Streams of one computer that stay open. A browser opens six connections to one address and queues all others, so
further pages get new data and ask again after `AGAIN` [ms].
"""
AGAIN = 1000
VENT = (sys.executable, "-P", "-m", "pmabench", "vent")
LONGEST_VENT = 90.0
"""Time limit of the command [s]; a guard reports the result of its vent within a minute."""
TICK = 1.0
"""Longest time between two messages to a viewer [s], so that it knows that the link is alive."""
HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Connection": "close",
}


class Refused(Exception):
    """A refused request, with its HTTP status."""

    def __init__(self, status: int, why: str) -> None:
        self.status, self.why = status, why
        super().__init__(why)


class Server(ThreadingHTTPServer):
    """The view of one folder of runs at one address."""

    daemon_threads = True
    block_on_close = False

    def __init__(
        self, room: Room, token: str, address: str = "127.0.0.1", port: int = 0, *, vent: bool = False
    ) -> None:
        """Listens at once, answers after `start`. Port 0 takes a free one. Raises OSError if it is in use."""
        self.address_family = socket.AF_INET6 if ":" in address else socket.AF_INET
        super().__init__((address, port), _Handler)
        self.room = room
        self.token = token
        self.local = ipaddress.ip_address(address).is_loopback
        self.may_vent = vent and self.local
        self.vent_command: Sequence[str] = VENT
        number = self.server_address[1]
        written = f"[{address}]" if ":" in address else address
        self.hosts = {f"{written}:{number}"} | ({f"localhost:{number}"} if self.local else set())
        self.url = f"http://{written}:{number}"
        self.streams: Counter[str] = Counter()
        self._places = threading.BoundedSemaphore(MOST_CONNECTIONS)
        self._lock = threading.Lock()

    def start(self) -> None:
        """Start answering, in other threads."""
        self.room.start()
        threading.Thread(target=self.serve_forever, args=(0.2,), daemon=True).start()

    def stop(self) -> None:
        """End all streams and close."""
        self.room.stop()
        self.shutdown()
        self.server_close()

    def link(self, path: str = "/") -> str:
        """The address with its token."""
        return f"{self.url}{path}#t={self.token}"

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a thread, unless there are too many."""
        if not self._places.acquire(blocking=False):
            self.shutdown_request(request)
            return
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """As inherited; then release the slot."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._places.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore errors of a connection: a browser may disconnect at any time."""

    @contextmanager
    def stream(self, computer: str) -> Iterator[bool]:
        """Count a stream while it is written; yields whether it may stay open."""
        with self._lock:
            self.streams[computer] += 1
            stays = self.streams[computer] <= MOST_STREAMS
        try:
            yield stays
        finally:
            with self._lock:
                self.streams[computer] -= 1


class _Handler(BaseHTTPRequestHandler):
    """One request."""

    protocol_version = "HTTP/1.1"
    server_version = "pmabench"
    sys_version = ""
    timeout = LONGEST_WAIT
    server: Server

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing: an address may contain the token or other secrets."""

    def do_GET(self) -> None:
        """The page, a stream, or history."""
        self._answer({"/api/stream": self._stream, "/api/history": self._history})

    def do_POST(self) -> None:
        """The vent button."""
        self._answer({"/api/vent": self._vent})

    def _answer(self, known: dict[str, Any]) -> None:
        with suppress(ConnectionError, TimeoutError):
            try:
                parts = urlsplit(self.path)
                self._of_here()
                if parts.path in known:
                    self._allowed()
                    query = {name: values[-1] for name, values in parse_qs(parts.query).items()}
                    known[parts.path](query)
                elif self.command == "GET" and _is_page(parts.path):
                    body, policy = page()
                    self._send(200, body, "text/html; charset=utf-8", {"Content-Security-Policy": policy})
                else:
                    raise Refused(404, "there is nothing at this address")
            except Refused as refused:
                self._send(refused.status, f"{refused.why}\n".encode(), "text/plain; charset=utf-8")
            except ValueError:
                self._send(400, b"this request cannot be read\n", "text/plain; charset=utf-8")

    def _of_here(self) -> None:
        """Refuse other host names, and pages of another origin."""
        host = self.headers.get_all("Host") or []
        if len(host) != 1 or host[0].lower() not in self.server.hosts:
            raise Refused(421, "this server has another name; use the address that pmabench printed")
        origin = self.headers.get("Origin")
        if origin is not None and origin.lower() != f"http://{host[0].lower()}":
            raise Refused(403, "another page asks for this")

    def _allowed(self) -> None:
        """Refuse requests without the token, and those caused by a page of another origin."""
        if self.headers.get("Sec-Fetch-Site", "same-origin") != "same-origin":
            raise Refused(403, "another page asks for this")
        given = self.headers.get("Authorization", "")
        if not hmac.compare_digest(given.encode("utf-8", "replace"), f"Bearer {self.server.token}".encode()):
            raise Refused(401, "the token is missing or not the one of this server; open the printed address again")

    def _send(self, status: int, body: bytes, kind: str, more: dict[str, str] | None = None) -> None:
        packed = len(body) > 1000 and "gzip" in self.headers.get("Accept-Encoding", "")
        if packed:
            body = gzip.compress(body, 4)
        headers = {"Content-Type": kind, "Content-Length": str(len(body))} | (more or {})
        self._send_head(status, headers | ({"Content-Encoding": "gzip"} if packed else {}))
        self.wfile.write(body)

    def _send_head(self, status: int, headers: dict[str, str]) -> None:
        self.send_response(status)
        for name, value in (HEADERS | headers).items():
            self.send_header(name, value)
        self.end_headers()

    # -- data ---------------------------------------------------------------------------------------------------------

    def feed_at(self, address: str) -> Feed | None:
        """The feed that an address refers to now; None without one."""
        place = self.server.room.places
        folder = self.server.room.newest if address in {"", "/"} else place.run_at(address)
        return None if folder is None else self.server.room.feed_of(folder)

    def _history(self, query: dict[str, str]) -> None:
        """Send buckets of a time range."""
        feed = self.feed_at(query.get("at", "/"))
        if feed is None:
            raise Refused(404, "there is no such run")
        begin, end, span = (_seconds(query.get(name)) for name in ("begin", "end", "span"))
        data = feed.history(begin, end, span, max(10, int(query.get("most", "1500"))))
        self._send(200, json.dumps(data, separators=(",", ":")).encode(), "application/json")

    def _stream(self, query: dict[str, str]) -> None:
        """Send new data as server-sent events until the viewer leaves."""
        self._send_head(200, {"Content-Type": "text/event-stream; charset=utf-8"})
        self.close_connection = True
        with self.server.stream(str(self.client_address[0])) as stays:
            _Viewer(self, query.get("at", "/"), stays=stays).show()

    # -- vent ---------------------------------------------------------------------------------------------------------

    def _vent(self, _query: dict[str, str]) -> None:
        """Start `pmabench vent` for the bench of the newest run, if allowed, and answer with its result."""
        length = int(self.headers.get("Content-Length") or 0)
        if not 0 < length <= 1000:
            raise Refused(400, "a vent names its run")
        wanted = json.loads(self.rfile.read(length))
        feed = self.feed_at("/")
        if not self.server.may_vent or feed is None or not feed.may_vent:
            raise Refused(403, "venting from a browser needs `web_vent: true` in the bench file, and --vent")
        if not isinstance(wanted, dict) or wanted.get("run") != feed.id:
            raise Refused(409, "another run has begun; look at it first")
        if self.headers.get("Sec-Fetch-Site") != "same-origin" or self.headers.get("Origin") is None:
            raise Refused(403, "another page asks for this")
        result = vent(str(feed.state.files.bench.get("name", "")), self.server.vent_command)
        self._send(200, json.dumps(result).encode(), "application/json")


def _seconds(text: str | None) -> float | None:
    """A time [s]; ValueError if it is no number."""
    value = None if text is None else float(text)
    if value is not None and not abs(value) < 1e9:
        raise ValueError(text)
    return value


def _is_page(path: str) -> bool:
    what, _, rest = path.lstrip("/").partition("/")
    return (not what and not rest) or (what in {"run", "campaign", "session"} and bool(rest) and "/" not in rest)


class _Viewer:
    """One stream: follows an address, which may refer to another run later."""

    def __init__(self, handler: _Handler, address: str, *, stays: bool) -> None:
        self._handler = handler
        self._address = address
        self._stays = stays
        self._room = handler.server.room
        self._feed: Feed | None = None
        self._seen = Seen()
        self._list = ""

    def show(self) -> None:
        """Write until the viewer leaves or the server stops."""
        try:
            if not self._stays:
                self._write(f"retry: {AGAIN}\n\n")
            ticks = 0
            while not self._room.over:
                self._choose(look=ticks % 10 == 0)
                self._write(self._news(tick=ticks % 10 == 0))
                if not self._stays and self._feed is not None and self._feed.state.files.there:
                    return
                with self._room.changed:
                    self._room.changed.wait(TICK)
                ticks += 1
        finally:
            if self._feed is not None:
                self._room.leave(self._feed)

    def _choose(self, *, look: bool) -> None:
        """Change to another run if the address now refers to one; checked once a second."""
        if not look and self._feed is not None:
            return
        feed = self._handler.feed_at(self._address)
        if feed is not self._feed and feed is not None:
            if self._feed is not None:
                self._room.leave(self._feed)
            self._room.enter(feed)
            self._feed, self._seen = feed, Seen()

    def _news(self, *, tick: bool) -> str:
        if self._feed is None:
            root = self._room.places.root
            waiting = json.dumps({"there": False, "problem": f"no such run in {root}, or none yet", "id": ""})
            return f"event: run\ndata: {waiting}\n\n" if tick else ""
        messages = self._feed.fresh(self._seen)
        if tick:
            listed = json.dumps(self._room.places.listed(self._address, self._feed.folder), separators=(",", ":"))
            if listed != self._list:
                self._list = listed
                messages.append(("list", listed))
        text = "".join(f"event: {name}\ndata: {data}\n\n" for name, data in messages)
        return text or (": \n\n" if tick else "")

    def _write(self, text: str) -> None:
        if text:
            self._handler.wfile.write(text.encode())


def start(
    root: Path, token: str, address: str = "127.0.0.1", ports: tuple[int, ...] = (0,), *, vent: bool = False
) -> Server:
    """Start a server for the runs in `root`, at the first free one of `ports`.

    Raises OSError if none is free, or the address is not one of this computer.
    """
    failed: OSError | None = None
    for port in ports:
        try:
            server = Server(Room(root, vent=vent), token, address, port, vent=vent)
        except OSError as error:
            failed = error
            continue
        server.start()
        return server
    raise failed or OSError("no port was given")


def vent(bench: str, command: Sequence[str] = VENT) -> dict[str, Any]:
    """Vent a bench by its name: `confirmed` [bool], `result` in words, `actions` of the guard. Raises nothing.

    The view itself cannot vent: the command finds the guard and its key in the user's own files.
    """
    whole = [*command, "--json", "--", bench]
    try:
        ended = subprocess.run(
            whole, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=LONGEST_VENT, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return _not_confirmed(f"pmabench vent could not be run: {error}")
    try:
        benches = json.loads(ended.stdout)["benches"]
        results = [str(item["result"]) for item in benches]
        actions = [str(action) for item in benches for action in item["actions"]]
    except (ValueError, KeyError, TypeError):
        last = ended.stderr.strip().splitlines()
        return _not_confirmed(last[-1] if last else f"pmabench vent ended with exit code {ended.returncode}")
    confirmed = ended.returncode == 0 and bool(results) and all(result == "confirmed" for result in results)
    return {"confirmed": confirmed, "result": ", ".join(results), "actions": actions}


def _not_confirmed(why: str) -> dict[str, Any]:
    return {"confirmed": False, "result": why, "actions": []}
