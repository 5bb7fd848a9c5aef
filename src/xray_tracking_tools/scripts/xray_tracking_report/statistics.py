"""The statistics of reports. Arrays may hold NaN where a method has no answer."""
import dataclasses

import numpy
from scipy import stats


@dataclasses.dataclass
class Comparison:
    """Two-sided paired t-test of a - b."""
    n: int
    mean: float      # of the differences
    low: float       # 95 % confidence interval of the mean
    high: float
    t: float
    p: float
    effect: float    # Cohen's d_z: mean over standard deviation of the differences


def paired(a, b):
    """Over the pairs in which both are known; all NaN for fewer than two."""
    difference = numpy.asarray(a, float) - numpy.asarray(b, float)
    difference = difference[numpy.isfinite(difference)]
    n = len(difference)
    nan = float('nan')
    if n < 2:
        return Comparison(n, nan, nan, nan, nan, nan, nan)
    mean = difference.mean()
    deviation = difference.std(ddof=1)
    if deviation == 0.0:
        same = mean == 0.0
        far = numpy.copysign(numpy.inf, mean)
        return Comparison(n, mean, mean, mean, 0.0 if same else far, 1.0 if same else 0.0, 0.0 if same else far)
    result = stats.ttest_1samp(difference, 0.0)
    half = stats.t.ppf(0.975, n - 1) * deviation / numpy.sqrt(n)
    return Comparison(n, mean, mean - half, mean + half, float(result.statistic), float(result.pvalue),
                      mean / deviation)


def share_interval(hits, n):
    """Clopper and Pearson's 95 % interval of a share."""
    if n == 0:
        return float('nan'), float('nan')
    low = stats.beta.ppf(0.025, hits, n - hits + 1) if hits > 0 else 0.0
    high = stats.beta.ppf(0.975, hits + 1, n - hits) if hits < n else 1.0
    return float(low), float(high)


def quantiles(values):
    """min, p25, median, p75, p95, max, mean of the known ones; None if there are none."""
    values = numpy.asarray(values, float)
    values = values[numpy.isfinite(values)]
    if len(values) == 0:
        return None
    least, p25, median, p75, p95, most = numpy.percentile(values, [0, 25, 50, 75, 95, 100])
    return {'min': least, 'p25': p25, 'median': median, 'p75': p75, 'p95': p95, 'max': most, 'mean': values.mean(),
            'n': len(values)}


def normalised_errors(method, gold, centre, errors):
    """Normalised estimation error squared of the target's centre (3) and of the pose (6 degrees of freedom), a frame.

    errors: of errors_by_axis(). The covariance, of the patient frame's origin, is carried over to the centre."""
    translation, rotation = errors
    frames = len(translation)
    nees3 = numpy.full(frames, numpy.nan)
    nees6 = numpy.full(frames, numpy.nan)
    for k in range(frames):
        covariance = method.covariance[k]
        error = numpy.concatenate([translation[k], numpy.radians(rotation[k])])
        if not (numpy.isfinite(covariance).all() and numpy.isfinite(error).all()):
            continue
        x, y, z = method.poses.rotation[k] @ centre
        jacobian = numpy.eye(6)
        jacobian[:3, 3:] = -numpy.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        at_centre = jacobian @ covariance @ jacobian.T
        nees3[k] = _squared(at_centre[:3, :3], error[:3])
        nees6[k] = _squared(at_centre, error)
    return nees3, nees6


def _squared(covariance, error):
    """error' covariance^-1 error; NaN where the covariance is not positive definite."""
    scale = numpy.sqrt(numpy.diag(covariance).clip(0.0))
    if not (scale > 0.0).all():
        return numpy.nan
    try:
        factor = numpy.linalg.cholesky(covariance / numpy.outer(scale, scale))
    except numpy.linalg.LinAlgError:
        return numpy.nan
    white = numpy.linalg.solve(factor, error / scale)
    return float(white @ white)


@dataclasses.dataclass
class Calibration:
    """How a covariance fits the errors: with right ones the mean is the degrees of freedom, the share 0.95."""
    freedom: int
    n: int
    mean: float
    within: int      # frames within the 95 % ellipsoid
    low: float       # 95 % interval of that share
    high: float


def calibration(nees, freedom):
    known = nees[numpy.isfinite(nees)]
    within = int((known <= stats.chi2.ppf(0.95, freedom)).sum())
    low, high = share_interval(within, len(known))
    return Calibration(freedom, len(known), float(known.mean()) if len(known) else float('nan'), within, low, high)
