"""Sphinx configuration of the manual."""

from pathlib import Path
import re
import shutil
import sys
import xml.etree.ElementTree as ET

from sphinx.errors import ExtensionError

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
shutil.rmtree(ROOT / 'docs/reference/api', ignore_errors=True)  # pages of modules that moved

project = 'shepherd_ros'
manifest = ET.parse(ROOT / 'package.xml').getroot()
author = copyright = manifest.findtext('maintainer')
release = manifest.findtext('version')

extensions = [
    'myst_parser',
    'sphinx.ext.autodoc',
    'sphinx.ext.autosummary',
    'sphinx.ext.viewcode',
    'sphinx_copybutton',
]
myst_enable_extensions = ['colon_fence']
myst_heading_anchors = 3
exclude_patterns = ['_build']
suppress_warnings = ['ref.python']  # `type` of an annotation is a field of several classes, too

html_theme = 'furo'
html_title = f'shepherd_ros {release}'
html_static_path = ['_static']
html_css_files = ['manual.css']
copybutton_prompt_text = '$ '

autosummary_generate = True
autodoc_typehints = 'signature'
autodoc_member_order = 'bysource'
autodoc_default_options = {'members': True, 'undoc-members': False, 'show-inheritance': True}


def plain(app, what, name, obj, options, lines):
    """Escape in docstrings what reStructuredText would read as markup."""
    text = '\n'.join(lines)
    lines[:] = re.sub(r'(?<!`)([*|_])(?!`)', r'\\\1', text.replace('\\', r'\\')).split('\n')


def call_no_other_host(app, exception):
    """Refuse a page whose pictures, styles or programs are those of another host."""
    called = re.compile(r'<img[^>]*src="(?:http|//)|<(?:script|link)[^>]*="(?:http|//)[^>]*')
    pages = [] if exception else Path(app.outdir).rglob('*.html')
    for page in pages:
        if found := called.search(page.read_text(encoding='utf-8')):
            raise ExtensionError(f'{page}: {found[0]!r}; expected a file of the manual')


def setup(app):
    """Read docstrings as plain text; look at the pages that were written."""
    app.connect('autodoc-process-docstring', plain)
    app.connect('build-finished', call_no_other_host)
