"""The schemas of msg_schemas/: texts of message types, in the form of MCAP, and JSON schemas."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
import os
from pathlib import Path
import re
import sys
from typing import Any

from shepherd_ros.config import choices_of, Config, unknown_name
from shepherd_ros.resources import share_file
from shepherd_ros.wire.topics import contract, families

RULER = '=' * 80
SERVICE_PARTS = ('Request', 'Response', 'Event')
EVENT = (
    'service_msgs/ServiceEventInfo info\n{0}_Request[<=1] request\n{0}_Response[<=1] response\n'
)
_FIELD = re.compile(r'^\s*([A-Za-z0-9_/]+)(?:\[[^\]]*\])?\s', re.MULTILINE)
_PRIMITIVES = {'bool', 'byte', 'char', 'float32', 'float64', 'string'} | {
    f'{sign}int{bits}' for sign in ('', 'u') for bits in (8, 16, 32, 64)
}


def wire_types() -> list[str]:
    """Return every type of the contract, such as geometry_msgs/msg/PoseArray."""
    rows = (contract()[0] | families()).values()
    return sorted({kind for row in rows for kind in (row.type, row.alternative) if kind})


def schema_name(type_name: str) -> str:
    """Return the path of the text of a type in msg_schemas/: <package>/<Type>.msg."""
    return type_name.replace('/msg/', '/') + '.msg'


def schema_text(type_name: str) -> str:
    """Return the stored text of a type with all types nested in it, for an MCAP schema record."""
    try:
        path = share_file('msg_schemas', schema_name(type_name))
    except FileNotFoundError as error:
        raise unknown_name('message type', type_name, wire_types()) from error
    return path.read_text(encoding='utf-8')


def dependencies(text: str, package: str) -> list[str]:
    """Return the types used in a text of a package, such as std_msgs/Header, sorted."""
    used = set(_FIELD.findall(text)) - _PRIMITIVES
    return sorted(name if '/' in name else f'{package}/{name}' for name in used)


def nested_text(type_name: str, text_of: Callable[[str], str]) -> str:
    """
    Return the text of a type followed by those of all types nested in it, each once.

    text_of(std_msgs/Header) returns the text of one type. Order and rulers are those of rosbag2:
    depth first, the types of one text in alphabetical order.
    """
    included: set[str] = set()

    def expand(name: str) -> str:
        text = text_of(name)
        for dependency in dependencies(text, name.split('/')[0]):
            if dependency not in included:
                included.add(dependency)
                text += f'\n{RULER}\nMSG: {dependency}\n{expand(dependency)}'
        return text

    return expand(re.sub('/(msg|srv)/', '/', type_name))


def installed_text(name: str) -> str:
    """
    Return the text of one type, such as std_msgs/Header, from the installed packages.

    Parts of a service have names such as std_srvs/SetBool_Request, and _Response and _Event.
    """
    package, *_, message = name.split('/')
    service, _, part = message.rpartition('_')
    prefixes = [p for p in os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep) if p]
    for prefix in [*prefixes, sys.prefix]:
        share = Path(prefix, 'share', package)
        if (share / 'msg' / f'{message}.msg').is_file():
            return (share / 'msg' / f'{message}.msg').read_text(encoding='utf-8')
        if part in SERVICE_PARTS and (share / 'srv' / f'{service}.srv').is_file():
            text = (share / 'srv' / f'{service}.srv').read_text(encoding='utf-8')
            request, _, response = re.sub(r'^---\s*$', RULER, text, flags=re.M).partition(RULER)
            event = EVENT.format(f'{package}/{service}')
            return dict(zip(SERVICE_PARTS, (request, response, event), strict=True))[part]
    raise FileNotFoundError(f'{name} is not installed: expected package {package}, see README.md')


def config_schema(config: type[Config], **extra: Any) -> dict[str, Any]:
    """
    Return the JSON schema of Config.to_dict(): each option with its range, and nothing else.

    Sparse options may be missing.

    Keyword arguments are schemas of fields that are not options.
    """
    properties = dict(extra)
    for f in fields(config):
        if 'doc' in f.metadata:
            properties[f.name] = _option_schema(f.default, f.metadata)
    names = [f.name for f in fields(config) if f.metadata]
    order = [name for name in extra if name not in names] + names
    sparse = [f.name for f in fields(config) if f.metadata.get('sparse')]
    return {
        'description': (config.__doc__ or '').strip(),
        'type': 'object',
        'additionalProperties': False,
        'required': [name for name in order if name not in sparse],
        'properties': {name: properties[name] for name in order},
    }


def _option_schema(default: Any, metadata: Any) -> dict[str, Any]:
    kinds = {bool: 'boolean', int: 'integer', float: 'number', str: 'string'}
    schema: dict[str, Any] = {'description': metadata['doc'], 'type': kinds[type(default)]}
    for key, limit in (('minimum', 'low'), ('maximum', 'high')):
        if metadata.get(limit) is not None:
            schema[key] = metadata[limit]
    choices = choices_of(metadata)
    return schema | ({'enum': list(choices)} if choices else {})
