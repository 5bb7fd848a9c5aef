"""Whether what a run said of its poses was true: their covariance against their errors, and errors under an open gate."""
import dataclasses

import numpy
from scipy import stats

from .results import Results, ResultsError, box_moments, errors_by_axis
from .statistics import normalised_errors, share_interval

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
        if not numpy.isfinite(method.covariance).any() and any(method.source[1:]):
            continue
        nees3, nees6 = normalised_errors(method, results.gold, centre, errors_by_axis(method, results.gold, centre))
        found[method.name] = Answers(method.source[1:], numpy.array([gate == 'NONE' for gate in method.gate[1:]]),
                                     method.tre[1:], nees3[1:], nees6[1:])
    return found


def mean_interval(values):
    """Mean and half of its 95 % interval, as if frames were independent."""
    n = len(values)
    half = stats.t.ppf(0.975, n - 1) * values.std(ddof=1) / numpy.sqrt(n) if n > 1 else float('nan')
    return float(values.mean()) if n else float('nan'), float(half)


def calibration_row(all_answers, source):
    """Figures of the poses of one source in several runs; None if there are none."""
    figures = {}
    for freedom in (3, 6):
        values = numpy.concatenate([
            getattr(a, f'nees{freedom}')[[s == source for s in a.source]] for a in all_answers])
        values = values[numpy.isfinite(values)]
        if len(values) == 0:
            return None
        within = int((values <= stats.chi2.ppf(0.95, freedom)).sum())
        mean, half = mean_interval(values)
        low, high = share_interval(within, len(values))
        figures[f'nees{freedom}'] = {'n': len(values), 'mean': mean, 'half': half, 'within': within / len(values),
                                     'within_low': low, 'within_high': high}
    return figures


def upper_bound(errors, n):
    """Clopper and Pearson's one-sided 95 % bound of a probability; 1 where nothing was tried."""
    return 1.0 if n == 0 or errors == n else float(stats.beta.ppf(0.95, errors + 1, n - errors))


def calibration_table(rows):
    """Markdown. @param rows (name, source, calibration_row())"""
    lines = ['| | poses | n | centre: NEES of 3 | inside 95 % | pose: NEES of 6 | inside 95 % |', '|---|---|---|---|---|---|---|']
    for name, source, row in rows:
        cells = [f'{c["mean"]:.2f} ± {c["half"]:.2f} | {100 * c["within"]:.0f} % '
                 f'({100 * c["within_low"]:.0f} to {100 * c["within_high"]:.0f})'
                 for c in (row['nees3'], row['nees6'])]
        lines.append(f'| {name} | {source} | {row["nees3"]["n"]} | ' + ' | '.join(cells) + ' |')
    return '\n'.join(lines)
