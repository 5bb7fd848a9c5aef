"""Run-to-run comparison of accuracy with a stored baseline: {sequence: {method: {median, p95, without_pose}}}."""
import dataclasses

from . import statistics
from .results import UNCORRECTED

WORSE_SHARE = 0.10  # a regression is more than this share, or more than this length
WORSE_MM = 0.02


def figures_of(all_results):
    """What a later run is compared with."""
    figures = {}
    for results in all_results:
        if not results.has_gold:
            continue
        figures[results.name] = {}
        for name, method in results.methods.items():
            values = statistics.quantiles(method.judged_tre())
            if name != UNCORRECTED:
                figures[results.name][name] = {
                    'median': round(float(values['median']), 4) if values else None,
                    'p95': round(float(values['p95']), 4) if values else None,
                    'without_pose': method.lost() + method.failed()}
    return figures


@dataclasses.dataclass
class Change:
    sequence: str
    method: str
    what: str
    before: object
    now: object
    worse: bool

    def words(self):
        return f'{self.sequence}, {self.method}: {self.what} was {self.before}, is {self.now}'


def is_worse(before, now):
    """Of errors [mm]; no error at all, as nothing has a pose, is worse than any."""
    if now is None or before is None:
        return now is None and before is not None
    return now > before * (1.0 + WORSE_SHARE) or now > before + WORSE_MM


def changes(baseline, now):
    """Every figure of the baseline whose sequence was run. A method that is missing now is worse."""
    found = []
    for sequence, methods in baseline.items():
        for method, before in methods.items() if sequence in now else ():
            figures = now[sequence].get(method)
            if figures is None:
                found.append(Change(sequence, method, 'the method', 'there', 'missing', True))
                continue
            for what in ('median', 'p95'):
                found.append(Change(sequence, method, what + ' (mm)', before[what], figures[what],
                                    is_worse(before[what], figures[what])))
            found.append(Change(sequence, method, 'exposures without a pose', before['without_pose'],
                                figures['without_pose'], figures['without_pose'] > before['without_pose']))
    return found
