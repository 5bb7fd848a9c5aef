"""Figures as SVG text that can stand in an HTML page."""
import io
import itertools
import re

import matplotlib
matplotlib.use('svg')
import matplotlib.pyplot as pyplot
import numpy
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, MaxNLocator
from scipy import stats

# Okabe and Ito's colours, which colour-blind people tell apart.
COLOURS = {'uncorrected': '#7d7d7d', 'tracking': '#0072b2', 'registration': '#d55e00',
           'tracking_and_registration': '#009e73', 'paper_tracking': '#56b4e9', 'paper_registration': '#e69f00'}
OTHER_COLOURS = ('#cc79a7', '#000000', '#8c6d31')
LABELS = {'uncorrected': 'uncorrected', 'tracking': 'tracking', 'registration': 'registration',
          'tracking_and_registration': 'tracking +\nregistration', 'paper_tracking': 'tracking,\nas published',
          'paper_registration': 'registration,\nas published'}
GATE_COLOURS = {'NONE': '#2ca05a', 'CONFIRMING': '#a9d8b8', 'UNVERIFIED': '#c9c9c9', 'DISPLACED': '#f2b447',
                'UNCERTAIN': '#d9a3d0', 'JUMP': '#e07b39', 'INCONSISTENT': '#b5342b', 'NOT_MEASURED': '#6d1f1a',
                'STALE': '#6a6a6a', 'BAD_STAMP': '#3d3d3d', 'NO_EXPOSURE': '#e6e6e6', 'HELD': '#4a6fa5'}
TOLERANCES = (1.2, 2.4)  # [mm], of the paper's successor
POINTS = 400             # of a curve: more cannot be seen on a page
WIDTH = 9.6              # [in]

pyplot.rcParams.update({
    'svg.fonttype': 'none', 'svg.hashsalt': 'xray_tracking', 'font.family': 'DejaVu Sans', 'font.size': 9,
    'axes.spines.top': False, 'axes.spines.right': False, 'axes.linewidth': 0.8, 'axes.titlesize': 9,
    'axes.grid': True, 'grid.color': '#e4e4e4', 'grid.linewidth': 0.6,
    'axes.axisbelow': True, 'legend.frameon': False, 'legend.fontsize': 8.5, 'lines.linewidth': 1.3,
    'xtick.color': '#333333', 'ytick.color': '#333333', 'axes.edgecolor': '#333333'})

_numbers = itertools.count(1)


def colour_of(method):
    return COLOURS.get(method) or OTHER_COLOURS[sum(map(ord, method)) % len(OTHER_COLOURS)]


def label_of(method):
    return LABELS.get(method, method.replace('_', ' '))


def line_label(method):
    return label_of(method).replace('\n', ' ')


def _svg(figure, description):
    """The figure as text without prologue; ids are the page's own, and the font is the reader's."""
    buffer = io.StringIO()
    figure.savefig(buffer, format='svg', metadata={'Date': None, 'Creator': None}, bbox_inches='tight', pad_inches=0.03)
    pyplot.close(figure)
    text = buffer.getvalue()
    text = text[text.index('<svg'):]
    text = re.sub(r'<metadata>.*?</metadata>', '', text, flags=re.DOTALL)
    text = re.sub(r'<!--.*?-->\s*', '', text, flags=re.DOTALL)
    prefix = f'f{next(_numbers)}-'
    text = re.sub(r'\bid="', f'id="{prefix}', text)
    text = text.replace('url(#', f'url(#{prefix}').replace('href="#', f'href="#{prefix}')
    text = text.replace("'DejaVu Sans'", "Arial, 'Liberation Sans', 'DejaVu Sans', sans-serif")
    # Thousandths of a point are enough for places; labels are left alone.
    text = re.sub(r'\b(?:d|points|transform|x|y)="[^"]*"', lambda m: re.sub(r'(\.\d{3})\d+', r'\1', m[0]), text)
    text = re.sub(r'<svg ([^>]*?)(width="[^"]*"|height="[^"]*") ?([^>]*?)(width="[^"]*"|height="[^"]*")',
                  r'<svg \1\3', text, count=1)
    return text.replace('<svg ', f'<svg role="img" aria-label="{description}" ', 1)


def _plain(value, _):
    return f'{value:g}'


def _log_axis(axes, values, least=None):
    """Where values span more than an order of magnitude."""
    known = numpy.concatenate([numpy.asarray(v, float).ravel() for v in values])
    known = known[numpy.isfinite(known) & (known > 0.0)]
    if len(known) and known.max() > 8.0 * known.min():
        axes.set_yscale('log')
        floor = known.min() if least is None else max(known.min(), least)
        axes.set_ylim(floor / 1.4, known.max() * 1.4)
        axes.yaxis.set_major_formatter(FuncFormatter(_plain))
        axes.yaxis.set_minor_formatter(FuncFormatter(lambda value, _: ''))
        axes.grid(True, which='minor', axis='y', linewidth=0.3)
    else:
        axes.set_ylim(bottom=0.0)


def _thinned(values):
    """Frames and values of a curve with at most about POINTS points: of every stretch the least and the largest."""
    values = numpy.asarray(values, float)
    frames = numpy.arange(len(values))
    if len(values) <= POINTS:
        return frames, values
    kept = set()
    for stretch in numpy.array_split(frames, POINTS // 2):
        known = stretch[numpy.isfinite(values[stretch])]
        if len(known):
            kept.update((known[numpy.argmin(values[known])], known[numpy.argmax(values[known])]))
        if len(known) < len(stretch):  # where there is a gap it stays one
            kept.add(stretch[~numpy.isfinite(values[stretch])][0])
    kept = numpy.array(sorted(kept))
    return kept, values[kept]


def _tolerances(axes, text):
    low, high = axes.get_ylim()
    for tolerance in TOLERANCES:
        if low < tolerance < high:
            axes.axhline(tolerance, color='#555555', linewidth=0.7, linestyle=(0, (5, 3)), zorder=1)
            if text:
                axes.annotate(f'{tolerance} mm', (1.0, tolerance), xycoords=('axes fraction', 'data'), fontsize=7.5,
                              color='#555555', ha='right', va='bottom')


def box_and_whisker(samples, axis_label):
    """Paper's figure 5. samples: (method, values) pairs."""
    samples = [(name, numpy.asarray(v)[numpy.isfinite(v)]) for name, v in samples]
    figure, axes = pyplot.subplots(figsize=(WIDTH, 3.9))
    _log_axis(axes, [v for _, v in samples])
    floor = axes.get_ylim()[0] if axes.get_yscale() == 'log' else 0.0
    for x, (name, values) in enumerate(samples):
        colour = colour_of(name)
        if len(values) == 0:
            axes.annotate('no pose', (x, 0.5), xycoords=('data', 'axes fraction'), ha='center', color=colour)
            continue
        low, p25, median, p75, high = numpy.maximum(numpy.percentile(values, [0, 25, 50, 75, 100]), floor)
        axes.plot([x, x], [low, p25], color=colour)
        axes.plot([x, x], [p75, high], color=colour)
        for end in (low, high):
            axes.plot([x - 0.12, x + 0.12], [end, end], color=colour)
        axes.add_patch(pyplot.Rectangle((x - 0.27, p25), 0.54, p75 - p25, facecolor=colour + '38', edgecolor=colour,
                                        linewidth=1.2))
        axes.plot([x - 0.27, x + 0.27], [max(values.mean(), floor)] * 2, color=colour, linewidth=2.4,
                  solid_capstyle='butt')
        axes.plot([x], [median], marker='s', color='white', markeredgecolor=colour, markersize=6, markeredgewidth=1.5)
    axes.set_xlim(-0.6, len(samples) - 0.4)
    axes.set_xticks(range(len(samples)))
    axes.set_xticklabels([label_of(name) for name, _ in samples])
    axes.tick_params(axis='x', length=0)
    axes.grid(False, axis='x')
    axes.set_ylabel(axis_label)
    _tolerances(axes, True)
    return _svg(figure, 'Box and whisker plots of ' + axis_label)


def _panels(count, height, **arguments):
    columns = 2 if count in (2, 4) else min(3, count)
    rows = -(-count // columns)
    figure, axes = pyplot.subplots(rows, columns, figsize=(WIDTH, height * rows + 0.3), squeeze=False,
                                   constrained_layout=True, **arguments)
    flat = list(axes.flat)
    for unused in flat[count:]:
        unused.set_axis_off()
    for i, panel in enumerate(flat[:count]):
        panel.tick_params(labelbottom=True)
        if i + columns >= count:  # nothing below
            panel.set_xlabel('frame')
    return figure, flat[:count], flat[:count:columns]


def _without_reference(values):
    """The first frame's error is none, and has no place on a logarithmic axis."""
    return numpy.concatenate([[numpy.nan], values[1:]])


def errors_over_frames(methods, uncorrected):
    """Paper's figure 6: a panel a method, the uncorrected curve dotted behind."""
    figure, panels, first_column = _panels(len(methods), 2.2, sharex=True, sharey=True)
    _log_axis(panels[0], [uncorrected[1:]] + [method.tre[1:] for method in methods], least=0.01)
    for axes, method in zip(panels, methods):
        frames, values = _thinned(_without_reference(uncorrected))
        axes.plot(frames, values, color=COLOURS['uncorrected'], linestyle=':', label='uncorrected')
        frames, values = _thinned(_without_reference(method.tre))
        marker = {'marker': 'o', 'markersize': 2.6} if len(frames) <= 60 else {}
        axes.plot(frames, values, color=colour_of(method.name), **marker)
        missing = [k for k, status in enumerate(method.status) if status != 'ok']
        if missing:
            axes.plot(missing[:POINTS], [0.96] * len(missing[:POINTS]), linestyle='', marker='x', markersize=4,
                      color='#b5342b', transform=axes.get_xaxis_transform())
        axes.set_title(line_label(method.name), color=colour_of(method.name), fontweight='bold', loc='left')
        axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=7))
        _tolerances(axes, False)
    for axes in first_column:
        axes.set_ylabel('TRE (mm)')
    return _svg(figure, 'TRE over frames, by method')


def times_over_frames(methods):
    """Paper's figure 7: processor time a frame on a logarithmic axis."""
    figure, axes = pyplot.subplots(figsize=(WIDTH, 3.2))
    for method in methods:
        frames, values = _thinned(numpy.where(method.cpu > 0.0, 1e3 * method.cpu, numpy.nan))
        axes.plot(frames, values, color=colour_of(method.name), label=line_label(method.name), marker='o' if
                  len(frames) <= 60 else None, markersize=2.6)
    axes.set_yscale('log')
    axes.yaxis.set_major_formatter(FuncFormatter(_plain))
    axes.set_ylabel('processor time (ms)')
    axes.set_xlabel('frame')
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=9))
    axes.legend(loc='lower center', bbox_to_anchor=(0.5, 1.0), ncol=3)
    return _svg(figure, 'Processor time of every frame')


def errors_by_axis(methods, errors):
    """errors: by method's name, (translation, rotation)."""
    figure, axes = pyplot.subplots(len(methods), 2, figsize=(WIDTH, 1.7 * len(methods) + 0.4), squeeze=False,
                                   sharex=True, constrained_layout=True)
    for row, method in zip(axes, methods):
        for panel, values, unit in zip(row, errors[method.name], ('mm', '°')):
            for axis, colour in zip(range(3), ('#c2412d', '#3b8c3b', '#2f5fb3')):
                panel.plot(*_thinned(values[:, axis]), color=colour, label='xyz'[axis], linewidth=1.1)
            panel.axhline(0.0, color='#333333', linewidth=0.6)
            panel.set_ylabel(unit)
            panel.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=7))
            panel.yaxis.set_major_locator(MaxNLocator(nbins=4))
        for panel, title in zip(row, (line_label(method.name) + ': translation', 'rotation')):
            panel.set_title(title, color=colour_of(method.name), fontweight='bold', loc='left')
    axes[0][1].legend(loc='lower right', bbox_to_anchor=(1.0, 0.98), ncol=3, handlelength=1.2)
    for panel in axes[-1]:
        panel.set_xlabel('frame')
    return _svg(figure, 'Translation and rotation error by room axis')


def normalised_errors(methods, nees, freedom):
    """nees: by method's name."""
    figure, panels, first_column = _panels(len(methods), 1.9, sharex=True, sharey=True)
    bounds = stats.chi2.ppf([0.025, 0.95, 0.975], freedom)
    for axes, method in zip(panels, methods):
        axes.axhspan(bounds[0], bounds[2], color='#009e73', alpha=0.12, linewidth=0)
        axes.axhline(freedom, color='#555555', linewidth=0.7)
        axes.axhline(bounds[1], color='#555555', linewidth=0.7, linestyle=(0, (5, 3)))
        frames, values = _thinned(nees[method.name])
        axes.plot(frames, values, color=colour_of(method.name), marker='o', markersize=2.4,
                  linewidth=0.9)
        axes.set_yscale('log')
        axes.yaxis.set_major_formatter(FuncFormatter(_plain))
        axes.set_title(line_label(method.name), color=colour_of(method.name), fontweight='bold', loc='left')
        axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=7))
    for axes in first_column:
        axes.set_ylabel('NEES')
    return _svg(figure, 'Normalised estimation error squared over frames')


def gate_over_time(methods):
    """A bar a method, coloured by the gate's reason in every frame."""
    figure, axes = pyplot.subplots(figsize=(WIDTH, 0.36 * len(methods) + 0.55))
    seen = []
    for row, method in enumerate(methods):
        start = 0
        for reason, frames in itertools.groupby(method.gate):
            length = len(list(frames))
            axes.broken_barh([(start - 0.5, length)], (row - 0.36, 0.72), facecolors=GATE_COLOURS.get(reason, '#ffffff'))
            start += length
            if reason not in seen:
                seen.append(reason)
    axes.set_yticks(range(len(methods)))
    axes.set_yticklabels([line_label(method.name) for method in methods])
    axes.set_ylim(len(methods) - 0.5, -0.5)
    axes.set_xlim(-0.5, len(methods[0].gate) - 0.5)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=9))
    axes.grid(False)
    axes.tick_params(axis='y', length=0)
    axes.set_xlabel('frame')
    axes.legend(handles=[Patch(color=GATE_COLOURS.get(r, '#ffffff'), label=gate_words(r)) for r in seen],
                loc='lower center', bbox_to_anchor=(0.42, 1.0), ncol=4)
    return _svg(figure, 'The beam gate over frames')


def gate_words(reason):
    return 'open' if reason == 'NONE' else reason.lower().replace('_', ' ')


def curves(named, axis_label):
    """Curves over frames: (label, colour, values)."""
    figure, axes = pyplot.subplots(figsize=(WIDTH, 2.7))
    _log_axis(axes, [values[1:] for _, _, values in named])
    for label, colour, values in named:
        axes.plot(*_thinned(_without_reference(values)), color=colour, label=label)
    axes.set_ylabel(axis_label)
    axes.set_xlabel('frame')
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=9))
    axes.legend(loc='lower center', bbox_to_anchor=(0.5, 1.0), ncol=3)
    return _svg(figure, axis_label + ' over frames')


def medians_by_sequence(names, rows):
    """A dot plot: a row a sequence, a mark a method. rows: by sequence, {method: (median, p95)}."""
    figure, axes = pyplot.subplots(figsize=(WIDTH, 0.27 * len(names) + 1.0))
    methods = [m for m in COLOURS if any(m in row for row in rows)]
    methods += sorted({m for row in rows for m in row} - set(methods))
    for i, method in enumerate(methods):
        points = [(row[method], y) for y, row in enumerate(rows) if method in row and numpy.isfinite(row[method][0])]
        offset = (i - (len(methods) - 1) / 2) * 0.12
        for (median, p95), y in points:
            axes.plot([median, p95], [y + offset] * 2, color=colour_of(method), linewidth=1.0, alpha=0.6)
        axes.plot([median for (median, _), _ in points], [y + offset for _, y in points], linestyle='', marker='o',
                  markersize=4.5, color=colour_of(method), label=line_label(method))
    axes.set_yticks(range(len(names)))
    axes.set_yticklabels(names)
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.set_xscale('log')
    axes.xaxis.set_major_formatter(FuncFormatter(_plain))
    axes.xaxis.set_minor_formatter(FuncFormatter(lambda value, _: ''))
    axes.set_xlabel('TRE (mm): median, and a line to the 95th percentile')
    for tolerance in TOLERANCES:
        axes.axvline(tolerance, color='#555555', linewidth=0.7, linestyle=(0, (5, 3)))
    axes.tick_params(axis='y', length=0)
    axes.legend(loc='lower center', bbox_to_anchor=(0.4, 1.0), ncol=3)
    return _svg(figure, 'Median TRE by sequence and method')
