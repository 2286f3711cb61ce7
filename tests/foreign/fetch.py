"""Fetch FMUs that other tools made: `python tests/foreign/fetch.py`, into out/foreign or $INTERAREA_FOREIGN.

Their licences let them be used and not passed on, so corpus.csv names each with tool, source and SHA-256, and
what does not have that digest is not kept. What is there already is not fetched again.
"""

from __future__ import annotations

import csv
import hashlib
import os
import sys
import urllib.request
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FOLDER = Path(os.environ.get("INTERAREA_FOREIGN") or ROOT / "out" / "foreign")
_PATIENCE_S = 60.0


@dataclass(frozen=True)
class Foreign:
    """An FMU: the tool that made it, where it is, its digest, and what `interarea` says ("" = it runs)."""

    tool: str
    repository: str
    commit: str
    path: str
    sha256: str
    refused: str

    @property
    def name(self) -> str:
        return f"{self.sha256[:8]}-{Path(self.path).name}"

    @property
    def file(self) -> Path:
        return FOLDER / self.name

    @property
    def url(self) -> str:
        return f"https://raw.githubusercontent.com/{self.repository}/{self.commit}/{self.path}"

    @property
    def there(self) -> bool:
        return self.file.is_file() and hashlib.sha256(self.file.read_bytes()).hexdigest() == self.sha256


def corpus() -> list[Foreign]:
    with (Path(__file__).parent / "corpus.csv").open(encoding="utf-8", newline="") as text:
        return [Foreign(**row) for row in csv.DictReader(text)]


def fetch(fmu: Foreign) -> str:
    """Fetch one; return why it is not here, "" when it is."""
    if fmu.there:
        return ""
    try:
        with urllib.request.urlopen(fmu.url, timeout=_PATIENCE_S) as answer:
            content = answer.read()
    except OSError as error:
        return f"{fmu.url}: {error}"
    result = hashlib.sha256(content).hexdigest()
    if result != fmu.sha256:
        return f"{fmu.url}: has SHA-256 {result}, wanted {fmu.sha256}"
    FOLDER.mkdir(parents=True, exist_ok=True)
    fmu.file.write_bytes(content)
    return ""


def main() -> int:
    """Return 0 when all are here."""
    missing = [why for why in map(fetch, corpus()) if why]
    for why in missing:
        print(why)
    print(f"{len(corpus()) - len(missing)} of {len(corpus())} in {FOLDER}")
    return 1 if missing else 0


if __name__ == "__main__":
    sys.exit(main())
