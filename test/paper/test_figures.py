"""Pictures of results can be read, in grey as well, and by the colour-blind."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
import numpy as np
from PIL import Image
import pytest
from shepherd_ros.controllers import CONTROLLERS
from shepherd_ros.experiments.catalog import EXPERIMENTS
from shepherd_ros.experiments.methods import label
from shepherd_ros.experiments.results import value_names
from shepherd_ros.experiments.samples import Samples
from shepherd_ros.experiments.setting import canonical_setting
from shepherd_ros.experiments.value_map import ValueMap
from shepherd_ros.paper.curves import Curve
from shepherd_ros.paper.drawing import save, spaced, style_of
from shepherd_ros.paper.figures import draw, draw_curves
from shepherd_ros.paper.judging import judge
from shepherd_ros.paper.primary import primary_policies
from shepherd_ros.paper.report import front_page
from shepherd_ros.paper.summary import compare_samples, draw_summary, QUESTION
from shepherd_ros.paper.value_picture import draw_values
from shepherd_ros.paper.verdict_picture import draw_verdicts
from shepherd_ros.policy.checkpoint import shipped_checkpoints

METHODS = ('policy:general', 'policy:imitation', 'strombom', 'pierson', 'drover')


def samples_in(name: str, episodes: int = 5) -> Samples:
    """Return made-up episodes of an experiment."""
    experiment = EXPERIMENTS[name]
    rng = np.random.default_rng(0)
    settings = tuple(dict.fromkeys(map(canonical_setting, experiment.settings)))
    size = (len(settings), episodes)
    values = {(m, v): rng.uniform(0.2, 0.8, size) for m in METHODS for v in value_names()}
    return Samples(experiment, settings, tuple(range(episodes)), 1000, values)


def shown(figure: Figure) -> list[Axes]:
    return [axes for axes in figure.axes if axes.get_visible()]


def texts(figure: Figure) -> set[str]:
    return {text.get_text() for axes in figure.axes for text in axes.texts}


def luminance(color: str) -> float:
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in to_rgb(color)]
    return float(np.dot(linear, (0.2126, 0.7152, 0.0722)))


def test_methods_differ_by_more_than_colour() -> None:
    policies = [f'policy:{name}' for name in shipped_checkpoints()]
    assert len(policies) > 4
    module = CONTROLLERS['ring'].__module__
    escorts = {'policy:escort', *(n for n, c in CONTROLLERS.items() if c.__module__ == module)}
    names = [*policies, 'unknown', *(name for name in CONTROLLERS if name != 'policy')]
    looks = {name: style_of(name, names) for name in names}
    herding = [looks[name] for name in names if name not in escorts]
    protection = [looks[name] for name in names if name in {*escorts, 'unknown', 'idle', 'random'}]
    assert len(protection) > 6
    for one, other in (*combinations(herding, 2), *combinations(protection, 2)):
        assert one['marker'] != other['marker']
        filled = [look['markerfacecolor'] != 'white' for look in (one, other)]
        in_grey = abs(luminance(one['color']) - luminance(other['color']))
        assert one['linestyle'] != other['linestyle'] or filled[0] != filled[1] or in_grey > 0.05


def test_a_shipped_policy_looks_the_same_in_every_picture() -> None:
    several = style_of('policy:strombom', ['policy:general', 'policy:strombom'])
    assert style_of('policy:strombom', ['policy:strombom']) == several


@pytest.mark.parametrize('name', ['fig4', 'fig5', 'fig6', 'fig7', 'fig8'])
def test_lines_have_units_numbers_of_episodes_and_labels_at_their_ends(name: str) -> None:
    samples = samples_in(name)
    figure = draw(samples)
    assert 'n = 5 episodes' in figure.get_suptitle()
    for axes in shown(figure):
        assert axes.get_xlabel().endswith(']')
        assert axes.get_ylabel().endswith(']')
        assert [t.get_text() for t in axes.texts if t.get_text() == label('pierson')]
        assert {label(method) for method in METHODS} <= {t.get_text() for t in axes.texts}
        assert not axes.get_legend()


@pytest.mark.parametrize('name', ['fractions', 'transfer', 'lidar', 'starts'])
def test_rows_of_settings_have_units_and_numbers_of_episodes(name: str) -> None:
    figure = draw(samples_in(name))
    assert 'n = 5 episodes' in ' '.join(figure.get_suptitle().split())
    assert all(axes.get_xlabel().endswith(']') for axes in shown(figure))
    assert {t.get_text() for t in figure.legends[0].texts} == {label(m) for m in METHODS}


@pytest.mark.parametrize(
    ('name', 'bars'), [('herdability', 1), ('table', 2), ('noise_repulsion', 2)]
)
def test_maps_have_a_bar_for_each_unit_and_labelled_contours(name: str, bars: int) -> None:
    samples = samples_in(name, episodes=1)
    figure = draw(samples)
    maps = [axes for axes in shown(figure) if axes.images]
    assert len(maps) == 2 * len(METHODS)
    assert len(shown(figure)) == len(maps) + bars
    assert {axes.get_xlabel()[-1:] for axes in maps} == {'', ']'}
    assert all(axes.get_ylabel().endswith(']') for axes in shown(figure)[len(maps) :])
    assert '0.5' in texts(figure)
    assert all(axes.images[0].norm.vmin == 0 for axes in maps)


def test_trainings_and_values_have_units_and_labels() -> None:
    x = np.linspace(0, 1e6, 20)
    curves = [Curve(f'{name}.{k}', x, x / 1e6, False) for name in ('a', 'b') for k in (0, 1)]
    figure = draw_curves(curves)
    (axes,) = figure.axes
    assert (axes.get_xlabel(), axes.get_ylabel()) == (
        'samples [million]',
        'return of an episode [1]',
    )
    assert {text.split('\n')[0] for text in texts(figure)} == {'a (n = 2)', 'b (n = 2)'}
    place = np.array([[1.0, 2.0], [3.0, 4.0]])
    slope = np.tile(np.linspace(0.0, 1.0, 41), (41, 1))  # means of patches from 0.05 to 0.95
    values = draw_values({'policy:general': ValueMap(slope, place, place, 4.0)})
    assert {'goal', 'sheep', 'two shepherds'} <= texts(values)
    assert {'0.2', '0.4', '0.6', '0.8'} <= texts(values)  # on the contours
    assert [axes.get_xlabel() for axes in values.axes] == ['x [m]', '']
    assert values.axes[1].get_ylabel() == "critic's value [1]"


def test_labels_are_moved_apart_in_their_order() -> None:
    assert spaced(np.array([0.5, 0.5, 0.9]), 0.1) == pytest.approx([0.5, 0.6, 0.9])
    assert spaced(np.array([0.99, 1.0, 1.0]), 0.1) == pytest.approx([0.8, 0.9, 1.0])


# ---- summary ----


def test_the_report_begins_with_the_answer() -> None:
    samples = {name: samples_in(name) for name in ('fig4', 'fig8')}
    figure = draw_summary(samples.values())
    assert figure is not None
    assert len(figure.axes) == 8
    assert QUESTION in figure.get_suptitle()
    assert 'n = 5 episodes' in figure.axes[0].get_title(loc='left')
    assert all(']' in axes.get_xlabel() for axes in figure.axes)
    rows = [text.get_text() for text in figure.axes[0].get_yticklabels()]
    assert rows == [label(m).removesuffix(' (ours)') for m in METHODS if m != 'drover']
    assert draw_summary([]) is None

    class NoRows:
        def distinct(self, name: str) -> list[str]:
            return []

        def __len__(self) -> int:
            return 0

    judged = judge('default', primary_policies('default'), samples, [], {})
    pictures = ['fig4', 'summary', 'verdicts']
    text = front_page([judged], {}, pictures, NoRows(), 'make paper')  # type: ignore[arg-type]
    drawn = [line for line in text.splitlines() if line.startswith('![')]
    assert text.splitlines()[2] == drawn[0]
    assert drawn[0].endswith('(verdicts.png)')
    assert drawn[1] == f'![{QUESTION}](summary.png)'
    assert sum(judged.about_baselines.values()) == 9, 'whatever rows there are'
    answer = text[: text.index('| preset')].splitlines()
    assert len([line for line in answer if line.startswith('- ')]) == 10


def test_the_picture_of_verdicts_has_a_row_for_each_statement_and_a_letter_for_each_preset() -> (
    None
):
    samples = {name: samples_in(name) for name in ('fig4', 'fig8')}
    judged = [
        judge(preset, primary_policies(preset), found, [], {})
        for preset, found in (('third', {}), ('default', samples))
    ]
    (axes,) = draw_verdicts(judged).axes
    words = [text.get_text() for text in axes.texts]
    assert sum(word.endswith(']') for word in words) == 35
    letters = [word for word in words if word in 'ABDU']
    assert len(letters) == 70
    assert letters[::2] == ['U'] * 35, 'no rows'
    for letter, kind in zip('ABDU', judged[1].counts, strict=True):
        assert letters[1::2].count(letter) == judged[1].counts[kind]


def test_a_policy_is_better_only_if_the_interval_says_so() -> None:
    own = np.linspace(1.0, 2.0, 50)
    assert compare_samples(own, own + 0.1, more=False, margin=0.0) == 'better'
    assert compare_samples(own, own + 0.1, more=True, margin=0.0) == 'worse'
    assert compare_samples(own, own + 0.1, more=True, margin=0.2) == 'same'
    assert compare_samples(own, own[::-1], more=True, margin=0.0) == 'same'
    assert compare_samples(own[:1], own[:1], more=True, margin=0.0) == ''


# ---- files ----


def test_a_picture_is_small_and_a_single_episode_is_drawn(tmp_path: Path) -> None:
    figure = draw_summary([samples_in('fig6', episodes=1)])
    assert figure is not None
    png, svg = save(figure, tmp_path, 'summary')
    assert svg.suffix == '.svg'
    with Image.open(png) as image:
        assert image.mode == 'P'
    assert png.stat().st_size < 60_000
