"""The command line as the tests of it call it."""

from __future__ import annotations

import sys

import pytest

from interarea.cli.app import main
from interarea.cli.terminal import DEBUG_VARIABLE


@pytest.fixture
def interarea(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]):  # type: ignore[no-untyped-def]
    """Return a call of the command: arguments -> (exit code, stdout, stderr)."""
    monkeypatch.delenv(DEBUG_VARIABLE, raising=False)

    def call(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["interarea", *(str(a) for a in arguments)])
        code = 0
        try:
            main()
        except SystemExit as stopped:
            code = int(stopped.code or 0)
        out, err = capfd.readouterr()
        return code, out, err

    return call
