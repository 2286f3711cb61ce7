"""The page in Firefox, opened from disk: it draws, has the bits of node for every preset, no error."""

from __future__ import annotations

import base64
import contextlib
import json
import os
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

PREFERENCES = {
    "browser.shell.checkDefaultBrowser": False,
    "datareporting.policy.dataSubmissionEnabled": False,
    "ui.prefersReducedMotion": 1,
}
EVERYTHING = """const [state, done] = arguments;
explorer.everything(state).then((run) => {
  const bytes = new Uint8Array(run.rows.buffer);
  let text = '';
  for (let k = 0; k < bytes.length; k += 32768) text += String.fromCharCode(...bytes.subarray(k, k + 32768));
  done([run.columns, btoa(text)]);
}, (error) => done([String(error), '']));"""
SHOWN = """const [done] = arguments;
const look = () => (window.explorer && explorer.result && explorer.result.exact && explorer.flying === 0
  ? requestAnimationFrame(() => requestAnimationFrame(() => done(true))) : setTimeout(look, 50));
look();"""
DRAWN = """return [...document.querySelectorAll('#plots canvas')].filter((c) => c.offsetParent).map((c) => {
  const seen = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
  let n = 0;
  for (let k = 4; k < seen.length; k += 4) n += seen[k] !== seen[0] || seen[k + 1] !== seen[1];
  return n;
});"""


class Firefox:
    """Firefox without a window, spoken to by its own protocol: `LENGTH:[0, number, name, arguments]`."""

    def __init__(self, path: str, profile: Path) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        expected = {**PREFERENCES, "marionette.port": port}
        lines = [f"user_pref({json.dumps(name)}, {json.dumps(value)});" for name, value in expected.items()]
        (profile / "user.js").write_text("\n".join(lines), encoding="utf-8")
        self.log = profile / "said.txt"
        command = [path, "--headless", "--marionette", "--no-remote", "--profile", str(profile)]
        with self.log.open("wb") as log:
            self.process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)
        self.socket = self._connected(port)
        self.socket.settimeout(180)
        self.number = 0
        self._read()  # the greeting
        self.call("WebDriver:NewSession", capabilities={})
        self.call("WebDriver:SetTimeouts", script=150_000)

    def _connected(self, port: int) -> socket.socket:
        until = time.monotonic() + 90
        while True:
            with contextlib.suppress(OSError):
                return socket.create_connection(("127.0.0.1", port), 5)
            assert self.process.poll() is None, self.log.read_text(errors="replace")
            assert time.monotonic() < until, "Firefox does not answer"
            time.sleep(0.1)

    def _read(self) -> Any:
        length = b""
        while not length.endswith(b":"):
            length += self._received(1)
        return json.loads(self._received(int(length[:-1])))

    def _received(self, count: int) -> bytes:
        data = b""
        while len(data) < count:
            more = self.socket.recv(min(65536, count - len(data)))
            assert more, "Firefox hung up"
            data += more
        return data

    def call(self, name: str, **arguments: Any) -> Any:
        self.number += 1
        message = json.dumps([0, self.number, name, arguments]).encode()
        self.socket.sendall(b"%d:%s" % (len(message), message))
        _, number, error, result = self._read()
        assert number == self.number
        assert error is None, error
        return result

    def run(self, script: str, *arguments: Any) -> Any:
        return self.call("WebDriver:ExecuteScript", script=script, args=arguments, sandbox=None)["value"]

    def wait(self, script: str, *arguments: Any) -> Any:
        """Run a script whose last argument is a function that takes the answer."""
        return self.call("WebDriver:ExecuteAsyncScript", script=script, args=arguments, sandbox=None)["value"]

    def quit(self) -> list[str]:
        """Return the errors and warnings of pages; Firefox has others of its own."""
        with contextlib.suppress(AssertionError, OSError):
            self.call("Marionette:Quit", flags=["eAttemptQuit"])
        self.socket.close()
        try:
            self.process.wait(30)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        lines = self.log.read_text(encoding="utf-8", errors="replace").splitlines()
        return [n for n in lines if n.startswith("JavaScript ") and ("file:" in n or "blob:" in n)]


@pytest.fixture
def firefox(tmp_path: Path) -> Iterator[Firefox]:
    path = shutil.which("firefox-esr") or shutil.which("firefox")
    if path is None:
        assert os.environ.get("INTERAREA_REQUIRE_FIREFOX") != "1", (
            "firefox is required here and not installed"
        )
        pytest.skip("no Firefox is installed")
    profile = tmp_path / "profile"
    profile.mkdir()
    started = Firefox(path, profile)
    try:
        yield started
    finally:
        started.quit()


@pytest.mark.slow
def test_presets_have_the_bits_of_node(firefox: Firefox, page: Path, runs_of_node: Any) -> None:
    """And node has those of the FMU (test_page_bits)."""
    firefox.call("WebDriver:Navigate", url=page.as_uri())
    assert firefox.wait(SHOWN) is True
    assert all(seen > 1000 for seen in firefox.run(DRAWN))
    assert firefox.run("return document.body.className") == ""
    for state, names, content in runs_of_node:
        columns, rows = firefox.wait(EVERYTHING, state)
        assert columns == names
        assert base64.b64decode(rows) == content
    assert firefox.run("explorer.preset(5); return 1") == 1
    assert firefox.wait(SHOWN) is True
    assert firefox.run("return document.getElementById('words').textContent").startswith("Synchronism lost")
    firefox.wait(
        "const [done] = arguments; setTimeout(done, 50); setTimeout(() => { throw new Error('heard'); });"
    )
    (only,) = firefox.quit()  # what the test itself threw
    assert "heard" in only
