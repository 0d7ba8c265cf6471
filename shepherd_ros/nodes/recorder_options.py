"""Options of the recorder on its command line: those of rosbag2, and a few more."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import re
from typing import Annotated, Literal

from rclpy.exceptions import InvalidTopicNameException
from rclpy.expand_topic_name import expand_topic_name
from rclpy.validate_full_topic_name import validate_full_topic_name
from shepherd_ros.config import ConfigError
from shepherd_ros.wire.contract import known
import tyro

SERVICE_EVENT_SUFFIX = (
    '/_service_event'  # behind the name of a service: what introspection publishes
)


@dataclass(frozen=True)
class RecorderOptions:
    """Record topics into a rosbag2 directory; by default those of the contract."""

    output: Annotated[str, tyro.conf.arg(aliases=['-o'])] = ''
    """Folder to write; by default rosbag2_ and the time."""
    topics: tuple[str, ...] = ()
    """Names of topics to record, instead of those of the contract."""
    regex: Annotated[str, tyro.conf.arg(aliases=['-e'])] = ''
    """Record topics whose name matches this regular expression, too."""
    exclude: Annotated[str, tyro.conf.arg(aliases=['-x'])] = ''
    """Leave out topics whose name matches this regular expression."""
    all: Annotated[bool, tyro.conf.arg(aliases=['-a'])] = False
    """Record every topic and the events of every service, but no hidden topic."""
    include_hidden_topics: bool = False
    """Record hidden topics, too: those with a name that begins with _ in their name."""
    services: tuple[str, ...] = ()
    """Names of services whose events to record."""
    all_services: bool = False
    """Record the events of every service."""
    compression: Literal['none', 'zstd', 'lz4'] = 'none'
    """Compression of chunks."""
    max_bag_size: Annotated[int, tyro.conf.arg(aliases=['-b'])] = 0
    """Go on in a new file after so many bytes; 0: never."""
    max_bag_duration: Annotated[float, tyro.conf.arg(aliases=['-d'])] = 0.0
    """Go on in a new file after so many seconds; 0: never."""
    per_episode: bool = False
    """One bag per episode: output/episode_0000 and so on."""
    start_paused: bool = False
    """Record nothing before ~/start is called."""
    use_sim_time: bool = False
    """Log times are those of /clock."""
    verbose: Annotated[bool, tyro.conf.arg(aliases=['-v'])] = False
    """Name every topic when it is found, and in the end every topic with losses."""

    def check(self) -> None:
        """Raise ConfigError for numbers out of range and invalid names."""
        if not (self.max_bag_size >= 0 and self.max_bag_duration >= 0):
            values = f'--max-bag-size is {self.max_bag_size}, -duration {self.max_bag_duration}'
            raise ConfigError(f'{values}: expected 0 (never) or more')
        _ = self.pattern('regex'), self.pattern('exclude')
        for option, names in (('topics', self.topics), ('services', self.services)):
            for name in names:
                try:
                    validate_full_topic_name(expand_topic_name(name, 'recorder', '/'))
                except (InvalidTopicNameException, ValueError):
                    raise ConfigError(
                        f'--{option} has {name!r}: expected names of {option}, such as '
                        '/flock/poses or shepherd_0/scan/sheep'
                    ) from None

    def pattern(self, name: str) -> re.Pattern[str] | None:
        """Return a compiled expression, None for ''; raises ConfigError for a bad one."""
        text = getattr(self, name)
        try:
            return re.compile(text) if text else None
        except re.error as error:
            reason = f'--{name} is {text!r}: expected a regular expression'
            raise ConfigError(f'{reason} ({error})') from None

    def topic_filter(self, resolve: Callable[[str], str]) -> Callable[[str], bool]:
        """Return the filter of full topic names; resolve(name) completes a relative one."""
        regex, exclude = self.pattern('regex'), self.pattern('exclude')
        names = {resolve(name) for name in self.topics}
        services = {resolve(name) for name in self.services}
        contract_too = not (names or services or regex or self.all or self.all_services)

        def accepts(name: str) -> bool:
            if exclude is not None and exclude.search(name):
                return False
            service = name.removesuffix(SERVICE_EVENT_SUFFIX)
            matched = self.all or (regex is not None and regex.search(service) is not None)
            if service != name:
                return matched or self.all_services or service in services or name in names
            if '/_' in name and not self.include_hidden_topics:
                return False
            return matched or name in names or (contract_too and known(name) is not None)

        return accepts
