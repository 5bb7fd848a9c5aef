"""The paper's findings (its section 3), judged on a cohort. A family is the methods that a finding speaks of."""
import dataclasses

import numpy
from scipy import stats

from . import statistics
from .results import UNCORRECTED

SIGNIFICANT = 0.05
STABLE_MM = 0.1  # of error that late frames may have more than early ones: what no beam's margin tells from none
OURS = ('this project', 'tracking', 'registration')
PUBLISHED = ('as published', 'paper_tracking', 'paper_registration')
COMBINED = 'tracking_and_registration'


@dataclasses.dataclass
class Finding:
    claim: str
    who: str
    held: object       # True, False, or None: not judged
    figures: str
    p: float = float('nan')


class Cohort:
    """Frames of all sequences with a gold standard, method by method: pooled, the first frames left out."""

    def __init__(self, all_results):
        self.sequences = [results for results in all_results if results.has_gold]

    def having(self, *methods):
        return [results for results in self.sequences if all(m in results.methods for m in methods)]

    def tre(self, method, sequences):
        return numpy.concatenate([r.methods[method].judged_tre() for r in sequences]) if sequences else numpy.array([])

    def pair(self, a, b):
        """Comparison of a - b, and in how many of how many sequences a's mean is less."""
        both = self.having(a, b)
        comparison = statistics.paired(self.tre(a, both), self.tre(b, both))
        less = sum(bool(statistics.paired(r.methods[a].judged_tre(), r.methods[b].judged_tre()).mean < 0.0)
                   for r in both)
        return comparison, less, len(both)


def judge(all_results):
    cohort = Cohort(all_results)
    names = {name for results in cohort.sequences for name in results.methods}
    found = [smaller(cohort, 'It corrects motion', _name(name), name, UNCORRECTED) for name in
             sorted(names - {UNCORRECTED})]
    for family in (PUBLISHED, OURS):
        who, tracking, registration = family
        found.append(smaller(cohort, 'Tracking is better than registration alone', who, tracking, registration))
    found.append(smaller(cohort, 'Tracking + registration is better than registration alone', OURS[0], COMBINED,
                         OURS[2]))
    found.append(smaller(cohort, 'Tracking + registration is better than registration alone',
                         'against the published registration', COMBINED, PUBLISHED[2]))
    found.append(alike(cohort, 'Tracking and tracking + registration do not differ', OURS[0], OURS[1], COMBINED))
    for who, tracking, _ in (PUBLISHED, OURS):
        found.append(drifts(cohort, who, tracking))
    found.append(stable(cohort, OURS[0], COMBINED))
    for family in (PUBLISHED, OURS):
        found.append(worst_when_large(cohort, *family))
    found.append(faster(cohort))
    return found


def _words(comparison, less, n, a, b):
    return (f'{_name(a)} − {_name(b)}: {comparison.mean:+.3f} mm ({comparison.low:+.3f} to {comparison.high:+.3f}), '
            f'n = {comparison.n}, d = {comparison.effect:+.2f}; smaller in {less} of {n} sequences').replace('-', '−')


def _name(method):
    return {'tracking_and_registration': 'tracking + registration', 'paper_tracking': 'tracking as published',
            'paper_registration': 'registration as published'}.get(method, method)


def smaller(cohort, claim, who, a, b):
    """Held if a's errors are significantly smaller than b's."""
    return _compared(cohort, claim, who, a, b, lambda c: c.mean < 0.0 and c.p < SIGNIFICANT)


def alike(cohort, claim, who, a, b):
    """Held if they do not differ significantly."""
    return _compared(cohort, claim, who, a, b, lambda c: c.p >= SIGNIFICANT)


def _compared(cohort, claim, who, a, b, held):
    comparison, less, n = cohort.pair(a, b)
    if comparison.n < 2:
        return Finding(claim, who, None, f'needs {_name(a)} and {_name(b)}')
    return Finding(claim, who, bool(held(comparison)), _words(comparison, less, n, a, b), comparison.p)


def _one_sided(statistic, p, sign):
    """Of a two-sided P, that of a statistic of this sign."""
    return float(p / 2.0 if statistic * sign > 0.0 else 1.0 - p / 2.0)


def _early_and_late(cohort, method):
    """Errors in the first and the last third of every sequence's judged frames."""
    early, late = [], []
    for results in cohort.having(method):
        third = results.methods[method].judged_tre()
        length = max(1, len(third) // 3)
        early.append(third[:length])
        late.append(third[-length:])
    known = [v[numpy.isfinite(v)] for v in (numpy.concatenate(early), numpy.concatenate(late))] if early else None
    return known if known and min(map(len, known)) > 1 else None


def drifts(cohort, who, method):
    return _late(cohort, 'Tracking drifts in late frames', who, method, 0.0, 1.0)


def stable(cohort, who, method):
    """By ruling out that late frames are worse by STABLE_MM or more."""
    return _late(cohort, 'Tracking + registration stays stable in late frames', who, method, STABLE_MM, -1.0)


def _late(cohort, claim, who, method, rise, sign):
    """Held if the late frames' errors exceed the early ones' by significantly more (sign 1) or less (-1) than `rise`."""
    thirds = _early_and_late(cohort, method)
    if thirds is None:
        return Finding(claim, who, None, f'needs {_name(method)}')
    early, late = thirds
    p = _one_sided(*stats.ttest_ind(late - rise, early, equal_var=False), sign)
    text = f'mean of the last third {late.mean():.3f} mm, of the first {early.mean():.3f} mm'
    text += f'; P is that of a rise by {rise} mm or more' if rise else ''
    return Finding(claim, who, p < SIGNIFICANT, text, p)


def worst_when_large(cohort, who, tracking, registration):
    claim = 'Registration alone is worst in frames with large motion'
    both = cohort.having(tracking, registration)
    if not both:
        return Finding(claim, who, None, f'needs {_name(tracking)} and {_name(registration)}')
    motion = cohort.tre(UNCORRECTED, both)
    errors = {m: cohort.tre(m, both) for m in (tracking, registration)}
    known = numpy.isfinite(errors[registration]) & numpy.isfinite(errors[tracking])
    if known.sum() < 8:
        return Finding(claim, who, None, 'fewer than 8 frames')
    rank, two_sided = stats.spearmanr(motion[known], errors[registration][known])
    p = _one_sided(rank, two_sided, 1.0)
    large = known & (motion >= numpy.percentile(motion[known], 75))
    of_large = {m: errors[m][large].mean() for m in errors}
    held = p < SIGNIFICANT and of_large[registration] > of_large[tracking]
    return Finding(claim, who, bool(held),
                   f'rank correlation of its error with the motion {rank:+.2f}; in the quarter of frames with '
                   f'the largest motion {of_large[registration]:.3f} mm, tracking {of_large[tracking]:.3f} mm'
                   .replace('-', '−'), p)


def faster(cohort):
    claim = 'Registration is faster after tracking'
    both = cohort.having(COMBINED, OURS[2])
    after = [r.methods[COMBINED].registration_cpu[1:] for r in both]
    alone = [r.methods[OURS[2]].registration_cpu[1:] for r in both]
    comparison = statistics.paired(numpy.concatenate(after), numpy.concatenate(alone)) if both else None
    if comparison is None or comparison.n < 2:
        return Finding(claim, OURS[0], None, 'needs registration and tracking + registration, with times')
    medians = [1e3 * numpy.nanmedian(numpy.concatenate(v)) for v in (after, alone)]
    return Finding(claim, OURS[0], bool(comparison.mean < 0.0 and comparison.p < SIGNIFICANT),
                   f'processor time of the registration, median: {medians[0]:.1f} ms after tracking, {medians[1]:.1f} ms '
                   f'alone, n = {comparison.n}', comparison.p)
