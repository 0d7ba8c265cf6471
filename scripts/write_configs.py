#!/usr/bin/env python3
"""Write config/<node>.yaml anew from the defaults of the nodes."""

from shepherd_ros.nodes.defaults import parameter_file, WITH_FILE
from shepherd_ros.resources import share_file

if __name__ == '__main__':
    for name in WITH_FILE:
        (share_file('config') / f'{name}.yaml').write_text(parameter_file(name), encoding='utf-8')
