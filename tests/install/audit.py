"""`make audit`: reports known vulnerabilities of the locked packages with pip-audit. Does not import this project.

Usage: audit.py PIP_AUDIT REQUIREMENTS [--strict]. Asks PyPI, then OSV. Exits with 1 on a known vulnerability. If no
advisory database is reachable, it audits nothing, prints a notice and exits with 0, or with 1 under --strict.
"""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any

_SERVICES = ("pypi", "osv")
_LIMIT_S = 300


def main() -> int:
    """Runs the audit and prints the result."""
    command, requirements, *options = sys.argv[1:]
    for service in _SERVICES:
        found, unknown, lines = summarise(_ask(command, requirements, service))
        if found or unknown < len(lines):
            break
    for line in filter(None, lines):
        _say(line)
    if found:
        _say(f"{found} known vulnerabilities: require fixed versions in pyproject.toml, and lock again")
        return 1
    if unknown == len(lines):
        _say("NOT AUDITED: neither PyPI's nor OSV's advisories could be reached; run `make audit` with access to them")
        return 1 if "--strict" in options else 0
    _say(f"no known vulnerability in {len(lines) - unknown} locked packages; {unknown} are in no advisory database")
    return 0


def _say(text: str) -> None:
    sys.stdout.write(f"{text}\n")


def summarise(report: dict[str, Any]) -> tuple[int, int, list[str]]:
    """Returns the numbers of vulnerabilities and unaudited packages, and a line (possibly empty) for each package."""
    found, unknown, lines = 0, 0, []
    for package in report.get("dependencies", []):
        flaws = package.get("vulns", [])
        found += len(flaws)
        unknown += "skip_reason" in package
        named = ", ".join(
            f"{flaw['id']} (fixed in {', '.join(flaw['fix_versions']) or 'no version'})" for flaw in flaws
        )
        lines.append(f"{package['name']} {package['version']}: {named}" if flaws else "")
    return found, unknown, lines


def _ask(command: str, requirements: str, service: str) -> dict[str, Any]:
    words = [command, "-r", requirements, "--no-deps", "--disable-pip", "-f", "json", "-s", service, "--timeout", "15"]
    try:
        said = subprocess.run(words, capture_output=True, text=True, timeout=_LIMIT_S).stdout
        report: dict[str, Any] = json.loads(said)
    except (subprocess.TimeoutExpired, json.JSONDecodeError):  # not reachable: pip-audit prints no JSON
        return {}
    return report


if __name__ == "__main__":
    sys.exit(main())
