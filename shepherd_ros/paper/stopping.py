"""Early end of experiments whose verdicts are certain before all episodes are run."""

from __future__ import annotations

from shepherd_ros.experiments.cells import EPISODES_AT_ONCE
from shepherd_ros.experiments.samples import Samples
from shepherd_ros.paper.claims import combined_verdict, finding_of, Sweep, UNDECIDED
from shepherd_ros.paper.statements import CLAIMS

ROUND = EPISODES_AT_ONCE  # episodes of each cell between two looks
CERTAIN = 0.999  # confidence of the intervals of a look, as there are several


def is_certain(samples: Samples, primary: str) -> bool:
    """
    Return whether more episodes would hardly change a verdict on an experiment.

    So it is if no statement is undecided by wider intervals; one number that disagrees makes the
    verdict on its statement certain.
    """
    own = [claim for claim in CLAIMS if claim.experiment == samples.experiment.name]
    for claim in own:
        found = [finding_of(c, Sweep(samples, primary), CERTAIN) for c in claim.clauses]
        if combined_verdict([finding.verdict for finding in found]) == UNDECIDED:
            return False
    return bool(own)
