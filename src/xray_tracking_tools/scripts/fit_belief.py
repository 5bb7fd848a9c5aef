#!/usr/bin/env python3
"""Learns the coefficients of the registration's belief, and judges it.

Reads tables of benchmark_registration's --csv: one row a registration, with all figures that the result gives of itself
and its true error. Fits the logistic model of belief.cpp (ridge, signs as the figures' meaning has them), prints its
table, and says of every table what would be believed. See docs/belief.md.
"""
import argparse
import csv
import math
import sys

import numpy

BELIEVED_TRE_MM = 1.5  # what a believed result is not off by; kBelievedError of registration.h
RIGHT_TRE_MM = 1.0
LEARNT_ERROR_MM = 1.0
PLACE_MM = 3.0  # what is off by less is at the right place; kAside of descender.cpp
KEPT_ERROR_MM = 0.6  # how well the place is kept is learnt from what is expected to be off by less
LEAST_SIMILARITY = 0.05  # and is like the images at all
SHOWN = 0.1  # similarity below which a view does not show what the others do; kShown of descender.cpp


def stretched(similarity):
    return math.atanh(min(max(similarity, -0.999), 0.999))


def log_of(value, least):
    return math.log(max(value, least))


def margin(row):
    if row['here'] <= 0.0:
        return -0.2
    return min(max((row['here'] - row['rival']) / row['here'], -0.2), 0.4)


# The terms of belief.cpp: name, what the model is given of the figures, the sign that its weight must have (+1 if more
# of it speaks for the result, -1 if against), and the weight that was learnt before.
TERMS = (
    ('expected error', lambda row: log_of(row['expected_error_mm'], 0.1), -1, -1.94),
    ('similarity', lambda row: stretched(row['least_similarity']), 1, 1.81),
    ("views' disagreement", lambda row: log_of(row['pull_mm'], 0.03), -1, -0.294),
    ('distinctness', lambda row: log_of(row['distinctness'], 0.5), 1, 1.35),
    ('margin over other places', margin, 1, 3.91),
)


def read_table(path):
    """Rows as dictionaries of numbers where they are numbers."""
    def number(text):
        try:
            return float(text)
        except ValueError:
            return text
    with open(path, newline='') as file:
        return [{key: number(value) for key, value in row.items()} for row in csv.DictReader(file)]


def features(rows):
    return numpy.array([[figure(row) for _, figure, _, _ in TERMS] for row in rows])


def errors(rows):
    return numpy.array([row['tre_mm'] for row in rows])


def within(rows):
    """How probable it is that errors of the expected size, along one direction, stay below the limit."""
    return numpy.array([math.erf(BELIEVED_TRE_MM / (math.sqrt(2.0) * max(row['expected_error_mm'], 0.01)))
                        for row in rows])


def losses_aside(rows):
    return numpy.array([min(max(row['loss_aside'], -0.05), 0.07) for row in rows])


def logistic(odds):
    return 1.0 / (1.0 + numpy.exp(-numpy.clip(odds, -50.0, 50.0)))


def probabilities(model, rows):
    """That errors stay within what is expected, that the place is right, and that it is kept there."""
    place, aside = model
    return (within(rows) * logistic(place[0] + features(rows) @ place[1:]) *
            logistic(aside[0] + aside[1] * losses_aside(rows)))


def of_unseen(rows, ridge):
    """Probabilities of each registration by what the other subjects teach, in five parts by subject."""
    subjects = sorted({row['subject'] for row in rows})
    part = numpy.array([subjects.index(row['subject']) % 5 for row in rows])
    p = numpy.zeros(len(rows))
    for left_out in range(5):
        model = fit([row for row, of in zip(rows, part) if of != left_out], ridge)
        p[part == left_out] = probabilities(model, [row for row, of in zip(rows, part) if of == left_out])
    return p


def newton(values, right, penalty, before):
    """Coefficients of a logistic model with a quadratic penalty on how far they are from those before."""
    theta = before.copy()
    for _ in range(100):
        p = logistic(values @ theta)
        gradient = values.T @ (right - p) - penalty * (theta - before)
        step = numpy.linalg.solve((values * (p * (1.0 - p))[:, None]).T @ values + numpy.diag(penalty), gradient)
        theta += step * min(1.0, 2.0 / numpy.abs(step).max())
        if numpy.abs(step).max() < 1e-8:
            break
    return theta


def fit(rows, ridge):
    """Of the place: intercept and weights; those with the wrong sign are left out. Of how it is kept: offset and slope."""
    # What is expected to be off by more is not believed whatever else speaks for it.
    rows = [row for row in rows if row['expected_error_mm'] < LEARNT_ERROR_MM]
    values, right = features(rows), errors(rows) < PLACE_MM
    mean, deviation = values.mean(axis=0), values.std(axis=0) + 1e-9
    scaled = numpy.column_stack([numpy.ones(len(values)), (values - mean) / deviation])
    signs = numpy.array([sign for _, _, sign, _ in TERMS])
    before = numpy.concatenate([[0.0], deviation * [weight for _, _, _, weight in TERMS]])
    used = numpy.ones(scaled.shape[1], bool)
    while True:
        theta = numpy.zeros(scaled.shape[1])
        theta[used] = newton(scaled[:, used], right, numpy.array([0.0] + [ridge] * len(TERMS))[used], before[used])
        wrong = theta[1:] * signs
        if wrong.min() >= 0.0:
            break
        used[1 + int(wrong.argmin())] = False
    slopes = theta[1:] / deviation
    near = [row for row in rows if row['tre_mm'] < PLACE_MM and row['expected_error_mm'] < KEPT_ERROR_MM and
            row['least_similarity'] > LEAST_SIMILARITY]
    loss = losses_aside(near)
    scale = loss.std() + 1e-9
    aside = newton(numpy.column_stack([numpy.ones(len(near)), loss / scale]), errors(near) < BELIEVED_TRE_MM,
                   numpy.array([0.0, 0.1]), numpy.zeros(2))
    return numpy.concatenate([[theta[0] - slopes @ mean], slopes]), aside / [1.0, scale]


def refused(rows, threshold):
    """Whatever the figures say: it is not so probable against a rival (rivalry.cpp), or a view shows something else."""
    return numpy.array([logistic(row['rival_odds']) < threshold or row['least_similarity'] < SHOWN for row in rows])


def judge(name, rows, p, threshold):
    tre = errors(rows)
    right, wrong = tre < RIGHT_TRE_MM, tre > BELIEVED_TRE_MM
    believed = (p >= threshold) & ~refused(rows, threshold)
    print('%-28s %5d %7d %8.1f %7d %8d   %.3f' %
          (name, len(rows), right.sum(), 100.0 * believed[right].mean() if right.any() else float('nan'), wrong.sum(),
           believed[wrong].sum(), numpy.mean((p - (tre < BELIEVED_TRE_MM)) ** 2)))
    return name, p, tre < BELIEVED_TRE_MM


def draw(path, judged):
    """Share that is right over the probability that is said, with as many registrations in each of ten bins."""
    import matplotlib
    matplotlib.use('Agg')
    from matplotlib import pyplot
    figure, axes = pyplot.subplots(figsize=(5, 5))
    axes.plot([0, 1], [0, 1], color='grey', linewidth=1)
    for name, p, right in judged:
        order = numpy.argsort(p)
        bins = [part for part in numpy.array_split(order, 10) if len(part)]
        axes.plot([p[part].mean() for part in bins], [right[part].mean() for part in bins], marker='o', label=name)
    axes.set_xlabel('probability that is said')
    axes.set_ylabel('share below %.1f mm' % BELIEVED_TRE_MM)
    axes.legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(path, metadata={'Date': None} if path.endswith('.svg') else None)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('learn', nargs='+', metavar='CSV', help='tables to learn on')
    parser.add_argument('--judge', nargs='*', default=[], metavar='NAME=CSV', help='tables to judge by')
    parser.add_argument('--threshold', type=float, default=0.95, help='probability from which a result is believed')
    parser.add_argument('--ridge', type=float, default=100.0,
                        help='penalty on how far weights of normalised figures are from those before')
    parser.add_argument('--picture', help='image file for the reliability diagram of the judged tables')
    arguments = parser.parse_args()
    # Of depth one view alone knows little: its results are right or wrong by chance, whatever the figures say.
    rows = [row for path in arguments.learn for row in read_table(path) if row['views'] > 1]
    model = fit(rows, arguments.ridge)
    place, aside = model
    centres = features(rows).mean(axis=0)
    print('offset %.3g' % (place[0] + place[1:] @ centres))
    print('%-28s %8s %8s' % ('term', 'centre', 'weight'))
    for (name, _, _, _), centre, weight in zip(TERMS, centres, place[1:]):
        print('%-28s %8.3g %8.3g' % (name, centre, weight))
    print('%-28s %8.3g %8.3g' % ('similarity aside', -aside[0] / aside[1], aside[1]))
    print('\n%-28s %5s %7s %8s %7s %8s   %s' % ('', 'n', '< 1 mm', 'bel. %', '> 1.5', 'believed', 'Brier'))
    judge('learnt on', rows, probabilities(model, rows), arguments.threshold)
    judged = [judge('unseen subjects', rows, of_unseen(rows, arguments.ridge), arguments.threshold)]
    for text in arguments.judge:
        name, _, path = text.partition('=')
        if not path:
            parser.error('--judge is %s, expected NAME=CSV' % text)
        table = read_table(path)
        judged.append(judge(name, table, probabilities(model, table), arguments.threshold))
    if arguments.picture:
        draw(arguments.picture, judged)
    return 0


if __name__ == '__main__':
    sys.exit(main())
