#!/usr/bin/env python3
"""Learns the coefficients of the registration's belief, and judges it.

Reads tables of benchmark_registration's --csv: one row a registration, with all figures that the result gives of itself
and its true error. Fits the logistic model of belief.cpp (ridge, signs as the figures' meaning has them), prints its
table, and says of every table what would be believed. See docs/belief.md.
"""
import argparse
import csv
import sys

import numpy

BELIEVED_TRE_MM = 1.5  # what a believed result is not off by; kBelievedTre of belief.h
RIGHT_TRE_MM = 1.0

# Name in the table, what the model is given of it, and the sign that its coefficient must have: +1 if more of it speaks
# for the result, -1 if against. The same transformations as in belief.cpp.
FIGURES = (
    ('deviation', lambda row: numpy.log(max(row['deviation_mm'], 0.01)), -1),
    ('similarity_least', lambda row: numpy.arctanh(numpy.clip(row['similarity_least'], -0.99, 0.99)), 1),
    ('coarse_least', lambda row: numpy.arctanh(numpy.clip(row['coarse_least'], -0.99, 0.99)), 1),
    ('pull', lambda row: numpy.log(max(row['pull_mean'], 0.01)), -1),
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
    return numpy.array([[figure(row) for _, figure, _ in FIGURES] for row in rows])


def errors(rows):
    return numpy.array([row['tre_mm'] for row in rows])


def probabilities(coefficients, values):
    return 1.0 / (1.0 + numpy.exp(-numpy.clip(coefficients[0] + values @ coefficients[1:], -50.0, 50.0)))


def fit(values, right, ridge):
    """Intercept and coefficients by Newton's method. Figures whose coefficient has the wrong sign are left out."""
    mean, deviation = values.mean(axis=0), values.std(axis=0) + 1e-9
    scaled = numpy.column_stack([numpy.ones(len(values)), (values - mean) / deviation])
    signs = numpy.array([sign for _, _, sign in FIGURES])
    used = numpy.ones(scaled.shape[1], bool)
    while True:
        part = scaled[:, used]
        penalty = numpy.diag([0.0] + [ridge] * (part.shape[1] - 1))
        theta = numpy.zeros(part.shape[1])
        for _ in range(100):
            p = 1.0 / (1.0 + numpy.exp(-numpy.clip(part @ theta, -50.0, 50.0)))
            gradient = part.T @ (right - p) - penalty @ theta
            step = numpy.linalg.solve((part * (p * (1.0 - p))[:, None]).T @ part + penalty, gradient)
            theta += step * min(1.0, 2.0 / numpy.abs(step).max())
            if numpy.abs(step).max() < 1e-8:
                break
        all_theta = numpy.zeros(scaled.shape[1])
        all_theta[used] = theta
        wrong = all_theta[1:] * signs
        if wrong.min() >= 0.0:
            slopes = all_theta[1:] / deviation
            return numpy.concatenate([[all_theta[0] - slopes @ mean], slopes])
        used[1 + int(wrong.argmin())] = False


def judge(name, rows, coefficients, threshold):
    p = probabilities(coefficients, features(rows))
    tre = errors(rows)
    right, wrong = tre < RIGHT_TRE_MM, tre > BELIEVED_TRE_MM
    believed = p >= threshold
    print('%-28s %5d %7d %8.1f %7d %8d   %.3f' %
          (name, len(rows), right.sum(), 100.0 * believed[right].mean() if right.any() else float('nan'), wrong.sum(),
           believed[wrong].sum(), numpy.mean((p - (tre < BELIEVED_TRE_MM)) ** 2)))
    return p, tre < BELIEVED_TRE_MM


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
    parser.add_argument('--threshold', type=float, default=0.9, help='probability from which a result is believed')
    parser.add_argument('--ridge', type=float, default=1.0, help='penalty on coefficients of normalised figures')
    parser.add_argument('--picture', help='image file for the reliability diagram of the judged tables')
    arguments = parser.parse_args()
    rows = [row for path in arguments.learn for row in read_table(path)]
    coefficients = fit(features(rows), errors(rows) < BELIEVED_TRE_MM, arguments.ridge)
    print('{ "intercept", %.4g },' % coefficients[0])
    for (name, _, _), coefficient in zip(FIGURES, coefficients[1:]):
        print('{ "%s", %.4g },' % (name, coefficient))
    print('\n%-28s %5s %7s %8s %7s %8s   %s' % ('', 'n', '< 1 mm', 'bel. %', '> 1.5', 'believed', 'Brier'))
    judge('learnt on', rows, coefficients, arguments.threshold)
    judged = []
    for text in arguments.judge:
        name, _, path = text.partition('=')
        if not path:
            parser.error('--judge is %s, expected NAME=CSV' % text)
        judged.append((name,) + judge(name, read_table(path), coefficients, arguments.threshold))
    if arguments.picture:
        draw(arguments.picture, judged)
    return 0


if __name__ == '__main__':
    sys.exit(main())
