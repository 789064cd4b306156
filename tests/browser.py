"""Drives Debian's Chromium by its debugging pipe, for tests of what people see in a browser; standard library only.

    with Browser(tmp_path / "profile") as browser:
        page = browser.open("http://127.0.0.1:8437/", width=390, dark=True)
        page.wait("document.title.startsWith('trial')")
        page.click("#print")
        assert page.problems == []

Messages of the Chrome DevTools Protocol are JSON ended by NUL, on descriptors 3 (to the browser) and 4 (from it).
One browser serves all tests of a session (`browser` in a conftest); each page has its own storage.
"""

import base64
import json
import os
import select
import shutil
import subprocess
import time
from pathlib import Path

CHROMIUM = shutil.which("chromium")
NOT_RUN = "not run: no chromium"
"""Reason of the skip where it is missing; tests/may_not_run.txt lists it."""
SWITCHES = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--remote-debugging-pipe",
    "--no-first-run", "--no-default-browser-check", "--disable-extensions", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--mute-audio", "--hide-scrollbars", "--force-color-profile=srgb",
)  # fmt: skip
KEYS = {"Enter": ("Enter", 13, "\r"), "Space": ("Space", 32, " "), "Escape": ("Escape", 27, ""), "Tab": ("Tab", 9, "")}


class Browser:
    """One browser process."""

    def __init__(self, profile):
        to_read, self._write = os.pipe()
        self._read, to_write = os.pipe()
        command = [CHROMIUM, *SWITCHES, f"--user-data-dir={profile}", "about:blank"]
        # A shell puts the pipes where the browser looks for them.
        moved = ["/bin/sh", "-c", f'exec "$@" 3</dev/fd/{to_read} 4>/dev/fd/{to_write}', "sh", *command]
        quiet = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        self._process = subprocess.Popen(moved, pass_fds=(to_read, to_write), **quiet)
        os.close(to_read)
        os.close(to_write)
        self._buffer = bytearray()
        self._count = 0
        self._answers = {}
        self._pages = {}

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def close(self):
        """End the browser."""
        if self._process.poll() is None:
            try:
                self.send("Browser.close")
                self._process.wait(5)
            except (OSError, subprocess.TimeoutExpired, EOFError, TimeoutError):
                self._process.kill()
                self._process.wait()
        for end in (self._read, self._write):
            if end is not None:
                os.close(end)
        self._read = self._write = None

    def send(self, method, session=None, within=20.0, **parameters):
        """Give a command and wait for its answer; AssertionError where the browser refuses it."""
        self._count += 1
        number = self._count
        message = {"id": number, "method": method, "params": parameters}
        if session is not None:
            message["sessionId"] = session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        end = time.monotonic() + within
        while number not in self._answers:
            self.listen(end - time.monotonic(), method)
        answer = self._answers.pop(number)
        assert "error" not in answer, f"{method}: {answer['error']}"
        return answer["result"]

    def listen(self, seconds, waiting_for=""):
        """Take messages of the browser until one has come, for so long [s] at most."""
        if not select.select([self._read], [], [], max(0.0, seconds))[0]:
            if waiting_for:
                raise TimeoutError(f"chromium does not answer {waiting_for}")
            return
        piece = os.read(self._read, 1 << 20)
        if not piece:
            raise EOFError("chromium has ended")
        self._buffer += piece
        *messages, rest = bytes(self._buffer).split(b"\0")
        self._buffer = bytearray(rest)
        for raw in messages:
            message = json.loads(raw)
            if "id" in message:
                self._answers[message["id"]] = message
            elif message.get("sessionId") in self._pages:
                self._pages[message["sessionId"]].take(message["method"], message["params"])

    def open(self, url, width=1280, height=900, *, dark=False, next_to=None, mobile=False):
        """A page of this size in its own storage, or in that of the page `beside`; returns when it is loaded."""
        context = next_to.context if next_to else self.send("Target.createBrowserContext")["browserContextId"]
        target = self.send("Target.createTarget", url="about:blank", browserContextId=context)["targetId"]
        session = self.send("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        page = self._pages[session] = Page(self, session, target, context)
        for domain in ("Page", "Runtime", "Log", "Network"):
            page.send(f"{domain}.enable")
        page.size(width, height, mobile=mobile)
        page.media(dark=dark)
        page.go(url)
        return page


class Page:
    """One tab."""

    def __init__(self, browser, session, target, context):
        self.browser, self.target, self.context = browser, target, context
        self._session = session
        self.problems = []
        """What the console said that is no plain message: errors, uncaught exceptions, breaches of the policy."""
        self.requests = []
        """Addresses that it asked for."""
        self._loaded = False

    def send(self, method, **parameters):
        """Give a command to this tab."""
        return self.browser.send(method, self._session, **parameters)

    def take(self, method, data):
        """Note an event of this tab."""
        if method == "Page.loadEventFired":
            self._loaded = True
        elif method == "Runtime.exceptionThrown":
            details = data["exceptionDetails"]
            self.problems.append(details.get("exception", {}).get("description") or details["text"])
        elif method == "Log.entryAdded" and data["entry"]["level"] in {"error", "warning"}:
            self.problems.append(f"{data['entry']['text']} {data['entry'].get('url', '')}".strip())
        elif method == "Runtime.consoleAPICalled" and data["type"] in {"error", "warning", "assert"}:
            self.problems.append(" ".join(str(a.get("value", a.get("description"))) for a in data["args"]))
        elif method == "Network.requestWillBeSent":
            self.requests.append(data["request"]["url"])

    def go(self, url, within=20.0):
        """Load an address and wait until it is loaded."""
        self._loaded = False
        self.send("Page.navigate", url=url)
        end = time.monotonic() + within
        while not self._loaded:
            if time.monotonic() > end:
                raise TimeoutError(f"{url} is not loaded after {within:g} s")
            self.browser.listen(0.1)

    def size(self, width, height, *, mobile=False):
        """Set the size of the window [CSS px]."""
        metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": mobile}
        self.send("Emulation.setDeviceMetricsOverride", **metrics)

    def media(self, *, dark=False, printed=False):
        """Dark or light, on screen or in print."""
        features = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        self.send("Emulation.setEmulatedMedia", media="print" if printed else "", features=features)

    def run(self, expression):
        """The value of a JavaScript expression; AssertionError where it throws."""
        options = {"returnByValue": True, "awaitPromise": True}
        answer = self.send("Runtime.evaluate", expression=expression, **options)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def wait(self, expression, within=10.0):
        """Wait until an expression is true; its value. AssertionError with the page's problems where it stays false."""
        end = time.monotonic() + within
        while not (value := self.run(expression)):
            assert time.monotonic() < end, f"after {within:g} s not true: {expression}; problems: {self.problems}"
            self.browser.listen(0.03)
        return value

    def text(self, selector):
        """The text that a person reads in the first element that a selector finds."""
        return self.run(f"document.querySelector({json.dumps(selector)}).innerText")

    def centre(self, selector):
        """The middle of an element [CSS px], scrolled into view."""
        return self.run(
            f"(() => {{const e = document.querySelector({json.dumps(selector)}); e.scrollIntoView({{block: 'center'}});"
            "const r = e.getBoundingClientRect(); return [r.x + r.width / 2, r.y + r.height / 2]})()"
        )

    def mouse(self, kind, x, y, **more):
        """One event of the mouse: `mousePressed`, `mouseReleased`, `mouseMoved`, `mouseWheel`."""
        button = "none" if kind in {"mouseMoved", "mouseWheel"} else "left"
        self.send("Input.dispatchMouseEvent", type=kind, x=x, y=y, **({"button": button, "clickCount": 1} | more))

    def click(self, selector, hold=0.0):
        """Press the mouse on an element for `hold` [s]."""
        x, y = self.centre(selector)
        self.mouse("mousePressed", x, y)
        time.sleep(hold)
        self.mouse("mouseReleased", x, y)

    def press(self, key):
        """Press a key: a character, or a name of `KEYS`."""
        code, number, text = KEYS.get(key, (f"Key{key.upper()}", ord(key.upper()[0]), key))
        shared = {"key": key if key != "Space" else " ", "code": code, "windowsVirtualKeyCode": number}
        self.send("Input.dispatchKeyEvent", type="keyDown", **shared, **({"text": text} if text else {}))
        self.send("Input.dispatchKeyEvent", type="keyUp", **shared)

    def picture(self, path, *, whole=False):
        """Save what is seen as PNG; `whole`: down to the end of the page."""
        found = self.send("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        Path(path).write_bytes(base64.b64decode(found["data"]))

    def pdf(self, path):
        """Print on A4 as PDF."""
        size = {"paperWidth": 8.27, "paperHeight": 11.69, "printBackground": True, "preferCSSPageSize": True}
        Path(path).write_bytes(base64.b64decode(self.send("Page.printToPDF", **size)["data"]))

    def close(self):
        """Close the tab."""
        self.send("Page.close")
