"""The bill of materials of a release: what is in the wheel, and what it needs, in CycloneDX 1.6.

    python tests/sbom.py dist       writes dist/feeddrive-0.1.0.cdx.json beside the wheel there

Bundled parts are in the wheel itself: packages of the page of the studio, with the hashes of page/package-lock.json,
and the headers of FMI.  Python packages are those that the wheel names, with the versions and hashes of locks/dev.txt,
with which the release was tested; the wheel names ranges, so that an installation may have newer ones.
"""

from __future__ import annotations

import base64
import hashlib
import json
import os
import re
import sys
import uuid
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from email import message_from_bytes
from email.message import Message
from importlib import metadata
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
LOCK = ROOT / "locks" / "dev.txt"
FOR_DEVELOPMENT = {"dev", "docs", "testing"}  # extras that no user of the wheel needs
FMI = ("2.0.1", "3.0")  # versions of the headers
_PACKAGE = re.compile(r"(?P<name>[A-Za-z0-9._-]+)(?:\[[^]]*\])?==(?P<version>[^ ;\\]+)(?: ; (?P<marker>[^\\]+))?")
_NEEDED_BY = re.compile(r"    #(?: via|  ) (\S+)")


@dataclass
class Locked:
    """A package of the lock: what it is, the hashes of its files, and the packages that need it."""

    name: str
    version: str
    marker: str
    hashes: list[str] = field(default_factory=list)
    needed_by: set[str] = field(default_factory=set)

    @property
    def ref(self) -> str:
        """The package URL."""
        return f"pkg:pypi/{self.name}@{self.version}"


def normal(name: str) -> str:
    """Return the name of a Python package in its normal form (PEP 503)."""
    return re.sub(r"[-_.]+", "-", name).lower()


def locked(text: str) -> list[Locked]:
    """Read a lock that uv has written."""
    packages: list[Locked] = []
    for line in text.splitlines():
        if match := _PACKAGE.match(line):
            packages.append(Locked(normal(match["name"]), match["version"], (match["marker"] or "").strip()))
        elif match := re.search(r"--hash=sha256:([0-9a-f]{64})", line):
            packages[-1].hashes.append(match[1])
        elif match := _NEEDED_BY.match(line):
            packages[-1].needed_by.add(normal(match[1]))
    return packages


def needed(packages: Iterable[Locked], first: Iterable[str]) -> list[Locked]:
    """Return the packages of these names, and all that they need."""
    packages = list(packages)
    names, left = set[str](), set(first)
    while left:
        names |= left
        left = {package.name for package in packages if package.needed_by & left} - names
    return [package for package in packages if package.name in names]


def requirements(wheel: Message) -> tuple[set[str], set[str]]:
    """Return the packages that a wheel always needs, and those of extras for users."""
    always, optional = set[str](), set[str]()
    for line in wheel.get_all("Requires-Dist", []):
        name = normal(re.split(r"[\s\[<>=!~;(]", line, maxsplit=1)[0])
        extra = re.search(r"extra\s*==\s*['\"]([^'\"]+)", line)
        if extra is None:
            always.add(name)
        elif extra[1] not in FOR_DEVELOPMENT:
            optional.add(name)
    return always, optional


def license_of(name: str) -> list[dict[str, Any]]:
    """Return the license that an installed package states; nothing if it is not installed or states none."""
    try:
        stated = metadata.metadata(name)
    except metadata.PackageNotFoundError:
        return []
    if expression := stated.get("License-Expression"):
        return [{"expression": expression}]
    text = str(stated.get("License") or "").strip()
    # some packages put the whole text there, and some state it as a classifier
    kinds = [kind.rpartition(" :: ")[2] for kind in stated.get_all("Classifier", []) if kind.startswith("License :: ")]
    names = [text] if text and "\n" not in text else kinds
    return [{"license": {"name": name}} for name in names]


def bundled(page: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the parts that are in the wheel itself; `page` is page/package-lock.json."""
    parts: list[dict[str, Any]] = []
    for place, package in page["packages"].items():
        if not place or package.get("dev") or package.get("optional"):
            continue
        name, version = place.rpartition("node_modules/")[2], package["version"]
        kind, _, digest = package["integrity"].partition("-")
        parts.append(
            {
                "type": "library",
                "bom-ref": f"pkg:npm/{name}@{version}",
                "name": name,
                "version": version,
                "purl": f"pkg:npm/{name}@{version}",
                "licenses": [{"expression": package["license"]}],
                "externalReferences": [
                    {
                        "type": "distribution",
                        "url": f"https://www.npmjs.com/package/{name}/v/{version}",
                        "hashes": [
                            {"alg": kind.upper().replace("SHA", "SHA-"), "content": base64.b64decode(digest).hex()}
                        ],
                    }
                ],
                "properties": [{"name": "feeddrive:bundled", "value": "feeddrive/studio/page"}],
            }
        )
    parts += [
        {
            "type": "library",
            "bom-ref": f"fmi-headers@{version}",
            "name": "FMI headers",
            "version": version,
            "licenses": [{"expression": "BSD-2-Clause"}],
            "externalReferences": [{"type": "website", "url": "https://fmi-standard.org"}],
            "properties": [{"name": "feeddrive:bundled", "value": "feeddrive/export/fmi/headers"}],
        }
        for version in FMI
    ]
    return parts


def bill(wheel: Message, digest: str, lock: str, page: Mapping[str, Any], made: datetime) -> dict[str, Any]:
    """Return the bill of materials of a wheel with this metadata and SHA-256."""
    name, version = normal(wheel["Name"]), wheel["Version"]
    own = f"pkg:pypi/{name}@{version}"
    always, optional = requirements(wheel)
    packages = locked(lock)
    listed = needed(packages, always | optional)
    if missing := (always | optional) - {package.name for package in listed}:
        raise SystemExit(f"sbom: {LOCK.name} lacks {', '.join(sorted(missing))}: run  make lock")
    required = {package.ref for package in needed(packages, always)}
    inside = bundled(page)
    components = inside + [
        {
            "type": "library",
            "bom-ref": package.ref,
            "name": package.name,
            "version": package.version,
            "purl": package.ref,
            "scope": "required" if package.ref in required else "optional",
            "licenses": license_of(package.name),
            "externalReferences": [
                {
                    "type": "distribution",
                    "url": f"https://pypi.org/project/{package.name}/{package.version}/",
                    "hashes": [{"alg": "SHA-256", "content": content} for content in package.hashes],
                }
            ],
            "properties": [{"name": "feeddrive:marker", "value": package.marker}] if package.marker else [],
        }
        for package in listed
    ]
    first = [package.ref for package in listed if package.name in always | optional]
    dependencies = [{"ref": own, "dependsOn": [*(part["bom-ref"] for part in inside), *first]}]
    dependencies += [
        {"ref": above.ref, "dependsOn": [package.ref for package in listed if above.name in package.needed_by]}
        for above in listed
    ]
    return {
        "$schema": "http://cyclonedx.org/schema/bom-1.6.schema.json",
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "serialNumber": f"urn:uuid:{uuid.uuid5(uuid.NAMESPACE_URL, f'{own}#{digest}')}",
        "version": 1,
        "metadata": {
            "timestamp": made.strftime("%Y-%m-%dT%H:%M:%SZ"),
            "component": {
                "type": "library",
                "bom-ref": own,
                "name": name,
                "version": version,
                "purl": own,
                "licenses": [{"expression": wheel["License-Expression"]}],
                "hashes": [{"alg": "SHA-256", "content": digest}],
            },
        },
        "components": components,
        "dependencies": dependencies,
    }


def metadata_of(wheel: Path) -> Message:
    """Return the METADATA of a wheel."""
    with zipfile.ZipFile(wheel) as packed:
        (name,) = [name for name in packed.namelist() if name.endswith(".dist-info/METADATA")]
        return message_from_bytes(packed.read(name))


def write(folder: Path) -> Path:
    """Write the bill of materials of the only wheel in a folder beside it, and return its path."""
    (wheel,) = folder.glob("*.whl")
    stated = metadata_of(wheel)
    page = json.loads((ROOT / "page" / "package-lock.json").read_text(encoding="utf-8"))
    seconds = os.environ.get("SOURCE_DATE_EPOCH")
    made = datetime.now(UTC) if seconds is None else datetime.fromtimestamp(int(seconds), UTC)
    digest = hashlib.sha256(wheel.read_bytes()).hexdigest()
    whole = bill(stated, digest, LOCK.read_text(encoding="utf-8"), page, made)
    path = folder / f"{normal(stated['Name'])}-{stated['Version']}.cdx.json"
    path.write_text(json.dumps(whole, indent=1) + "\n", encoding="utf-8")
    return path


if __name__ == "__main__":
    print(write(Path(sys.argv[1])))
