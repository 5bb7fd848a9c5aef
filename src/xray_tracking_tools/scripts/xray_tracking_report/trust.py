"""Whether what a run said of its poses is true: covariance against error, and errors under an open gate."""
import dataclasses

import numpy
from scipy import stats

from .results import Results, ResultsError, box_moments, errors_by_axis
from .statistics import calibration, normalised_errors

LIMIT = 1.5  # [mm], as belief is of (docs/belief.md)
SOURCES = ('registered', 'tracked')


@dataclasses.dataclass
class Answers:
    """Of a method, of the frames after the first; arrays of one entry a frame."""
    source: list
    open: numpy.ndarray   # the gate, after the frame
    tre: numpy.ndarray    # NaN without a pose
    nees3: numpy.ndarray  # of the target's centre
    nees6: numpy.ndarray  # of the pose


def answers(folder):
    """Of every method with a covariance, by its name. @raises ResultsError without a gold standard"""
    results = Results(folder)
    box = results.box()
    if results.gold is None or box is None:
        raise ResultsError(f'{folder}: no gold standard or no run.json, expected results of evaluate_sequence')
    centre, _ = box_moments(box)
    found = {}
    for method in results.estimating:
        if not numpy.isfinite(method.covariance).any() and numpy.isfinite(method.tre[1:]).any():
            continue
        nees3, nees6 = normalised_errors(method, results.gold, centre, errors_by_axis(method, results.gold, centre))
        found[method.name] = Answers(method.source[1:], numpy.array([gate == 'NONE' for gate in method.gate[1:]]),
                                     method.tre[1:], nees3[1:], nees6[1:])
    return found


def calibration_row(all_answers, source):
    """Calibration of the target's centre and of the pose, of the poses of one source in several runs; None if there are
    none."""
    figures = []
    for freedom in (3, 6):
        nees = numpy.concatenate([numpy.array(getattr(a, f'nees{freedom}'))[[s == source for s in a.source]]
                                  for a in all_answers] or [numpy.zeros(0)])
        figures.append(calibration(nees, freedom))
    return figures if figures[0].n else None


def upper_bound(errors, n):
    """Clopper and Pearson's one-sided 95 % bound of a probability; 1 where nothing was tried."""
    return 1.0 if n == 0 or errors == n else float(stats.beta.ppf(0.95, errors + 1, n - errors))


def calibration_table(rows):
    """Markdown. @param rows (name, source, calibration_row())"""
    lines = ['| | poses | n | centre: NEES of 3 | inside 95 % | pose: NEES of 6 | inside 95 % |',
             '|---|---|---|---|---|---|---|']
    for name, source, row in rows:
        cells = [f'{c.mean:.2f} | {100.0 * c.within / c.n:.0f} % ({100.0 * c.low:.0f} to {100.0 * c.high:.0f})'
                 for c in row]
        lines.append(f'| {name} | {source} | {row[0].n} | ' + ' | '.join(cells) + ' |')
    return '\n'.join(lines)
