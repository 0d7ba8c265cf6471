"""Checks of what DDS is told: domain, discovery range, profile, multicast."""

from __future__ import annotations

from collections.abc import Iterator
import os
from pathlib import Path
import socket
import xml.etree.ElementTree as ET

from shepherd_ros.doctor.diagnosis import Diagnosis, error, ok, warning

_LAST_DOMAIN = 232  # the ports of the next are too high
PORT_BASE, PORTS_PER_DOMAIN = 7400, 250
EPHEMERAL = Path('/proc/sys/net/ipv4/ip_local_port_range')
_RANGES = ('SUBNET', 'LOCALHOST', 'OFF', 'SYSTEM_DEFAULT')
PROFILES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')
MULTICAST = ('239.255.0.1', 7400)  # where participants of domain 0 announce themselves
PATIENCE = 1.0  # [s] for a datagram on this machine


def check_domain() -> Iterator[Diagnosis]:
    """Yield whether ROS_DOMAIN_ID is a domain whose ports nobody else is given."""
    text = os.environ.get('ROS_DOMAIN_ID') or '0'
    if not (text.isdecimal() and int(text) <= _LAST_DOMAIN):
        fix = f'export ROS_DOMAIN_ID to a number from 0 to {_LAST_DOMAIN}'
        yield error('domain', f'ROS_DOMAIN_ID is {text!r}', fix)
        return
    first = PORT_BASE + PORTS_PER_DOMAIN * int(text)
    try:
        low, high = map(int, EPHEMERAL.read_text(encoding='utf-8').split())
    except (OSError, ValueError):
        low, high = 1 << 16, 1 << 16
    if first + PORTS_PER_DOMAIN > low and first <= high:
        taken = f'ports {first} to {first + PORTS_PER_DOMAIN - 1} are given to other programs'
        fix = f'use a domain up to {(low - PORT_BASE) // PORTS_PER_DOMAIN - 1}'
        yield warning('domain', f'ROS_DOMAIN_ID is {text}: {taken}', fix)
    else:
        note = '' if os.environ.get('ROS_DOMAIN_ID') else ', as ROS_DOMAIN_ID is not set'
        yield ok('domain', f'{text}{note}')


def discovery_range() -> str:
    """Return how far nodes look for each other."""
    return os.environ.get('ROS_AUTOMATIC_DISCOVERY_RANGE') or 'SUBNET'


def check_discovery_range() -> Iterator[Diagnosis]:
    """Yield how far nodes look for each other."""
    chosen, peers = discovery_range(), os.environ.get('ROS_STATIC_PEERS', '')
    also = f'; ROS_STATIC_PEERS is {peers}' if peers else ''
    if chosen not in _RANGES:
        fix = f'export it as one of {", ".join(_RANGES)}'
        yield error('discovery range', f'ROS_AUTOMATIC_DISCOVERY_RANGE is {chosen!r}', fix)
    elif chosen == 'OFF' and not peers:
        fix = 'export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST, or SUBNET for several hosts'
        yield error('discovery range', 'OFF: nodes do not find each other', fix)
    elif os.environ.get('ROS_LOCALHOST_ONLY') == '1':
        fix = 'unset it and export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST'
        yield warning('discovery range', 'ROS_LOCALHOST_ONLY is 1, which is deprecated', fix)
    else:
        yield ok('discovery range', f'{chosen}{also}')


def check_profile() -> Iterator[Diagnosis]:
    """Yield whether the XML profiles of Fast DDS can be read, if there are any."""
    paths = {name: os.environ[name] for name in PROFILES if os.environ.get(name)}
    for name, path in paths.items():
        try:
            root = ET.parse(path).getroot()
        except (OSError, ET.ParseError) as fault:
            fix = f'export {name} to the path of an XML file, or unset it'
            yield error('DDS profile', f'{name} is {path} ({fault})', fix)
            continue
        if root.tag.rpartition('}')[2] not in ('profiles', 'dds'):
            fix = 'use a file such as config/fastdds_quick.xml'
            yield error('DDS profile', f'{path} holds <{root.tag}>, no profiles', fix)
            continue
        yield ok('DDS profile', path)
    if not paths:
        yield ok('DDS profile', 'the default of Fast DDS')


def check_multicast() -> Iterator[Diagnosis]:
    """Yield whether a datagram to the group of DDS comes back, as hosts of a subnet need it."""
    if discovery_range() in ('LOCALHOST', 'OFF'):
        yield ok('multicast', f'not needed: the discovery range is {discovery_range()}')
        return
    fix = (
        'nodes of other hosts need ROS_STATIC_PEERS; on one machine export '
        'ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST'
    )
    try:
        group = MULTICAST[0]
        with (
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ear,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as mouth,
        ):
            ear.bind(('', 0))
            ear.settimeout(PATIENCE)
            anywhere = socket.inet_aton(group) + socket.inet_aton('0.0.0.0')
            ear.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, anywhere)
            mouth.sendto(b'shepherd doctor', (group, ear.getsockname()[1]))
            ear.recv(64)
        yield ok('multicast', f'a datagram to {group} comes back')
    except OSError as fault:
        yield warning('multicast', f'a datagram to {group} does not come back ({fault})', fix)
