"""Structures and units as the files of a TwinCAT 3 PLC project: .TcDUT and .TcPOU."""

from __future__ import annotations

import uuid

from feeddrive.export.structured_text.units import Structure, Unit

_HEAD = '<?xml version="1.0" encoding="utf-8"?>\n<TcPlcObject Version="1.1.0.1" ProductVersion="3.1.4024.12">\n'


def twincat_file(each: Structure | Unit) -> tuple[str, str]:
    """Name and content of the file of a structure, function or function block."""
    if isinstance(each, Structure):
        body = f"    <Declaration><![CDATA[{_cdata(each.text())}]]></Declaration>\n"
        return f"{each.name}.TcDUT", _wrapped("DUT", each.name, "", body)
    body = (
        f"    <Declaration><![CDATA[{_cdata(each.declaration())}]]></Declaration>\n"
        f"    <Implementation>\n      <ST><![CDATA[{_cdata(each.implementation())}]]></ST>\n    </Implementation>\n"
    )
    return f"{each.name}.TcPOU", _wrapped("POU", each.name, ' SpecialFunc="None"', body)


def _wrapped(tag: str, name: str, more: str, body: str) -> str:
    """The same name has the same identity, so that an export made anew replaces the file in a project."""
    identity = uuid.uuid5(uuid.NAMESPACE_URL, f"feeddrive/{tag}/{name}")
    return f'{_HEAD}  <{tag} Name="{name}" Id="{{{identity}}}"{more}>\n{body}  </{tag}>\n</TcPlcObject>\n'


def _cdata(text: str) -> str:
    """Text that cannot end the section it stands in."""
    return text.replace("]]>", "]] >")
