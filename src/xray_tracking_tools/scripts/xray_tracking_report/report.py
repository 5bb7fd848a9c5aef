"""The report of one sequence."""
import itertools
import os

import numpy
from markupsafe import Markup

from . import figures, html, pictures, statistics
from .results import Results, UNCORRECTED, box_distance, box_moments, errors_by_axis

# Shares of frames under 1.2 and 2.4 mm of the paper's successor (IEEE Trans Med Imaging 24(11), 2005).
FOLLOW_UP = (('2005: hyperplane tracking', 0.32, 0.82), ('2005: 2D normalised mutual information', 0.82, 0.96))
WITHIN = (1.2, 2.4)


class Numbering:
    def __init__(self):
        self._counts = {}

    def __call__(self, kind):
        self._counts[kind] = self._counts.get(kind, 0) + 1
        return f'{kind} {self._counts[kind]}.'


def summary_row(name, tre, lost, failed):
    """A method's figures over judged frames; lost and failed ones are not within."""
    figures_of = statistics.quantiles(tre)
    shares = [float((tre < limit).sum()) / len(tre) if len(tre) else float('nan') for limit in WITHIN]
    if figures_of is None:
        return [html.method_cell(name), len(tre), lost + failed] + ['–'] * 5 + [html.percent(s) for s in shares]
    return [html.method_cell(name), len(tre), lost + failed, html.mm(figures_of['median']), html.mm(figures_of['mean']),
            html.mm(figures_of['p25']) + '–' + html.mm(figures_of['p75']), html.mm(figures_of['p95']),
            html.mm(figures_of['max'])] + [html.percent(s) for s in shares]


SUMMARY_HEAD = ['method', 'n', 'without pose', 'median', 'mean', '25–75 %', '95 %', 'max', '< 1.2 mm', '< 2.4 mm']


def summary_table(rows, number, caption):
    theirs = [[name, '–', '–', '–', '–', '–', '–', '–', html.percent(a), html.percent(b)] for name, a, b in FOLLOW_UP]
    return html.table(SUMMARY_HEAD, rows + theirs, number, caption, quiet=range(len(rows), len(rows) + len(theirs)))


def comparison_rows(samples):
    """samples: {method: errors}; every pair."""
    rows = []
    for a, b in itertools.combinations(samples, 2):
        c = statistics.paired(samples[a], samples[b])
        rows.append([html.method_cell(a), html.method_cell(b), c.n, signed(c.mean),
                     f'{signed(c.low)} to {signed(c.high)}' if c.n > 1 else '–', signed(c.t, 2), html.probability(c.p), signed(c.effect, 2)])
    return rows


COMPARISON_HEAD = ['a', 'b', 'n', 'a − b, mm', '95 % interval', 't', 'P', 'effect d']
COMPARISON_CAPTION = (
    'Two-sided paired t-tests of the TRE over the frames in which both methods have a pose; d is the mean difference '
    'over its standard deviation. P is not corrected for the number of comparisons, and frames of one sequence are not '
    'independent of each other, so that a P near 0.05 says less than it seems to.')


def signed(value, digits=3):
    return f'{value:+.{digits}f}'.replace('-', '−') if numpy.isfinite(value) else '–'


def sections(folder):
    """(results, parts) of a results folder."""
    results = Results(folder)
    number = Numbering()
    parts = [html.heading(f'Target tracking in “{results.name}”', 1), html.paragraph(lead(results), class_='lead')]
    if results.frames < 2:
        parts += [html.paragraph('There is no exposure after the first one, so nothing is judged.', class_='warning')]
        parts += missing(results)
    else:
        parts += with_gold(results, number) if results.has_gold else without_gold(results, number)
        parts += times(results, number)
    parts += gate(results, number)
    parts += radiographs(results, number)
    parts += provenance(results, number)
    return results, parts


def lead(results):
    duration = results.stamps[-1] - results.stamps[0]
    detectors = len(results.run.get('setup', {}).get('detectors', []))
    text = '1 exposure' if results.frames == 1 else f'{results.frames} exposures'
    text += (f' of {detectors} views' if detectors else '') + f' in {duration:g} s. '
    if results.has_gold:
        return text + ('Errors are target registration errors (TRE): the root mean square distance, over the box of the '
                       'target, between where the estimated and the true pose put it. The first exposure is the '
                       'reference and is not judged. “Uncorrected” is the error of a treatment that does not follow the '
                       'target.')
    return text + ('There is no gold standard, so nothing here is an error. What can be said is how well the views agree '
                   'with each other, and the methods.')


def missing(results):
    """A warning where methods have no pose, with the reasons."""
    rows = []
    for method in results.estimating:
        reasons = {}
        for k, status in enumerate(method.status):
            if status != 'ok':
                reasons.setdefault((status, method.reason[k]), []).append(k)
        for (status, reason), frames in reasons.items():
            rows.append([html.method_cell(method.name), status, frame_list(frames), reason or '–'])
    if not rows:
        return []
    return [html.table(['method', 'status', 'frames', 'why'], rows, 'Exposures without a pose.',
                       'They count as not within any limit.')]


def frame_list(frames, most=8):
    """3, 5–9, 12 and so on, shortened."""
    runs = []
    for frame in frames:
        if runs and frame == runs[-1][1] + 1:
            runs[-1][1] = frame
        else:
            runs.append([frame, frame])
    words = [str(a) if a == b else f'{a}–{b}' for a, b in runs]
    return ', '.join(words[:most]) + (f' and {len(words) - most} more' if len(words) > most else '')


def with_gold(results, number):
    judged = {name: method.judged_tre() for name, method in results.methods.items()}
    uncorrected = results.methods[UNCORRECTED].tre
    parts = [html.heading('Target registration error')]
    parts.append(summary_table(
        [summary_row(name, judged[name], m.lost(), m.failed()) for name, m in results.methods.items()], number('Table'),
        'TRE in mm over the frames after the first. Shares are of all frames, with or without a pose. The last two rows '
        'are the figures of the paper’s successor (IEEE Trans Med Imaging 24(11), 2005), on its own data.'))
    parts += missing(results)
    parts.append(html.figure(
        figures.box_and_whisker(list(judged.items()), 'TRE (mm)'), number('Figure'),
        'TRE by method: box from the 25th to the 75th percentile, whiskers to the least and the largest, square: median, '
        'bar: mean. Dashed: 1.2 and 2.4 mm. (The paper’s figure 5.)'))
    parts.append(html.figure(
        figures.errors_over_frames(results.estimating, uncorrected), number('Figure'),
        'TRE over frames; dotted: uncorrected; crosses above: frames without a pose. (The paper’s figure 6.)'))
    parts.append(html.table(COMPARISON_HEAD, comparison_rows(judged), number('Table'), COMPARISON_CAPTION))
    box = results.box()
    if box is None or results.gold is None:
        return parts
    centre, _ = box_moments(box)
    errors = {m.name: errors_by_axis(m, results.gold, centre) for m in results.estimating}
    parts.append(html.heading('Translation and rotation'))
    parts.append(html.figure(
        figures.errors_by_axis(results.estimating, errors), number('Figure'),
        'Error of the target’s centre and of its rotation vector along and about the room’s axes.'))
    rows = []
    for method in results.estimating:
        translation, rotation = (values[1:] for values in errors[method.name])
        rows.append([html.method_cell(method.name)] + [bias_and_spread(translation[:, i], 3) for i in range(3)] +
                    [bias_and_spread(rotation[:, i], 2) for i in range(3)])
    parts.append(html.table(['method', 'x, mm', 'y, mm', 'z, mm', 'about x, °', 'about y, °', 'about z, °'], rows,
                            number('Table'), 'Mean error ± standard deviation by room axis.'))
    return parts + calibration(results, errors, centre, number)


def bias_and_spread(values, digits):
    values = values[numpy.isfinite(values)]
    if len(values) == 0:
        return '–'
    spread = f' ± {values.std(ddof=1):.{digits}f}' if len(values) > 1 else ''
    return signed(values.mean(), digits) + spread


def calibration(results, errors, centre, number):
    """Whether the covariances are worth something."""
    shown, nees, rows = [], {}, []
    for method in results.estimating:
        nees3, nees6 = statistics.normalised_errors(method, results.gold, centre, errors[method.name])
        nees3[0] = nees6[0] = numpy.nan  # the reference
        if not numpy.isfinite(nees3).any():
            continue
        shown.append(method)
        nees[method.name] = nees3
        for what, values, freedom in (('target’s centre', nees3, 3), ('pose', nees6, 6)):
            c = statistics.calibration(values, freedom)
            rows.append([html.method_cell(method.name), what, c.n, html.mm(c.mean, 2), str(freedom),
                         html.percent(c.within / c.n) if c.n else '–',
                         f'{html.percent(c.low)} to {html.percent(c.high)}'])
    if not shown:
        return []
    return [html.heading('Covariance against error'),
            html.figure(figures.normalised_errors(shown, nees, 3), number('Figure'),
                        'Normalised estimation error squared (NEES) of the target’s centre over frames. With a right '
                        'covariance it averages 3 (line); 95 % of frames lie in the band, and below the dashed line, '
                        'which is the 95 % ellipsoid. Above: the covariance is too small; below: too large.'),
            html.table(['method', 'of', 'n', 'mean NEES', 'expected', 'within 95 % ellipsoid', 'interval of that share'],
                       rows, number('Table'),
                       'Coverage of the 95 % ellipsoid, with the exact (Clopper-Pearson) 95 % interval of the share.')]


def without_gold(results, number):
    parts = [html.heading('Poses')]
    parts.append(html.table(['method', 'n', 'lost', 'failed'], [
        [html.method_cell(m.name), results.frames - 1, m.lost(), m.failed()] for m in results.estimating],
        number('Table'), 'Frames after the first, and how many of them have no pose.'))
    parts += missing(results)
    parts.append(html.heading('Agreement of the views'))
    rows = []
    curves = []
    for method in results.estimating:
        values = statistics.quantiles(method.disagreement[1:])
        if values is not None:
            rows.append([html.method_cell(method.name), values['n'], html.mm(values['median']), html.mm(values['p95']),
                         html.mm(values['max'])])
            curves.append((figures.line_label(method.name), figures.colour_of(method.name), method.disagreement))
    if rows:
        parts.append(html.figure(figures.curves(curves, 'disagreement of views (px)'), number('Figure'),
                                 'By how much the tracks of the views contradict each other: root mean square of what no '
                                 'motion of the target explains.'))
        parts.append(html.table(['method', 'n', 'median, px', '95 %', 'max'], rows, number('Table'),
                                'Disagreement of the views’ tracks.'))
    else:
        parts.append(html.paragraph('No method reports it.'))
    box = results.box()
    pairs = list(itertools.combinations(results.estimating, 2))
    if box is None or not pairs:
        return parts
    parts.append(html.heading('Agreement of the methods'))
    rows, curves = [], []
    colours = itertools.cycle(('#0072b2', '#d55e00', '#009e73', '#cc79a7', '#56b4e9', '#e69f00', '#000000'))
    for (a, b), colour in zip(pairs, colours):
        distance = box_distance(a.poses, b.poses, box)
        values = statistics.quantiles(distance[1:])
        label = f'{figures.line_label(a.name)} / {figures.line_label(b.name)}'
        if values is not None:
            curves.append((label, colour, distance))
            rows.append([label, values['n'], html.mm(values['median']), html.mm(values['p95']), html.mm(values['max'])])
    if rows:
        parts.append(html.figure(figures.curves(curves, 'distance of poses (mm)'), number('Figure'),
                                 'Root mean square distance over the target box between two methods’ poses.'))
        parts.append(html.table(['methods', 'n', 'median, mm', '95 %', 'max'], rows, number('Table'),
                                'Distance of the methods’ poses over the target box.'))
    return parts


def times(results, number):
    methods = [m for m in results.estimating if (m.cpu > 0.0).any()]
    if not methods:
        return []
    rows = []
    for method in methods:
        values = statistics.quantiles(1e3 * method.cpu[1:])
        registration = statistics.quantiles(1e3 * method.registration_cpu[1:])
        if values is not None:
            rows.append([html.method_cell(method.name), html.mm(1e3 * method.cpu[0], 1), html.mm(values['median'], 1),
                         html.mm(values['mean'], 1), html.mm(values['max'], 1),
                         html.mm(registration['median'], 1) if registration else '–'])
    return [html.heading('Processor time'),
            html.figure(figures.times_over_frames(methods), number('Figure'),
                        'Processor time of every frame on all cores together. The first frame trains the trackers. (The '
                        'paper’s figure 7.)'),
            html.table(['method', 'first frame', 'median', 'mean', 'max', 'of it registration, median'], rows,
                       number('Table'), 'Processor time in ms; all but the first column without the first frame.')]


def gate(results, number):
    methods = [m for m in results.estimating if any(m.gate)]
    if not methods:
        return []
    rows = []
    for method in methods:
        frames_of = {}
        for k, reason in enumerate(method.gate):
            frames_of.setdefault(reason, []).append(k)
        for reason, frames in frames_of.items():
            words = Markup(f'<span class="swatch" style="background:{figures.GATE_COLOURS.get(reason, "#fff")}"></span>')
            rows.append([html.method_cell(method.name), words + figures.gate_words(reason), len(frames),
                         frame_list(frames), method.gate_text[frames[0]]])
    return [html.heading('Beam gate'),
            html.figure(figures.gate_over_time(methods), number('Figure'), 'What the gate said of every frame.'),
            html.table(['method', 'state', 'n', 'frames', 'in words, of the first of them'], rows, number('Table'),
                       'Every reason for which the beam was held. Advice of research software.')]


def radiographs(results, number):
    gallery = pictures.gallery(results)
    if not gallery:
        return []
    _, run = pictures.best_run(results)
    which = 'First, middle, last and worst' if results.has_gold else 'First, middle and last'
    return [html.heading('Radiographs'), gallery, html.paragraph(
        Markup('<b>') + number('Figure') + Markup('</b> ') +
        f'{which} frame by {figures.line_label(run["pictures_of"])}. {pictures_legend(results)}', class_='caption')]


def pictures_legend(results):
    legend = ('Dashed white: tracked region; green: target box at the estimated pose; orange: edges of the target’s '
              'digitally reconstructed radiograph at that pose')
    legend += '; dotted pink: target box at the true pose.' if results.gold is not None else '.'
    return legend


def provenance(results, number):
    run = results.run
    if not run:
        return []
    program = run['program']
    rows = [['program', f'xray_tracking {program["version"]}, revision {program["revision"]}']]
    rows.append(['built with', f'GCC {program["compiler"]}, OpenCV {program["OpenCV"]}, Eigen {program["Eigen"]}, Boost '
                 f'{program["Boost"].replace("_", ".")}'])
    rows.append(['processor', run['processor']])
    rows.append(['source', os.path.basename(os.path.normpath(run['source']))])
    for entry in run['inputs']:
        size = entry['bytes'] / 1e6
        rows.append([entry['what'], Markup('{} files, {} MB, SHA-256 <code>{}</code>').format(
            entry['files'], f'{size:.1f}', entry['sha256'])])
    setup = run['setup']
    box = setup['target_box_mm']
    rows.append(['target box, mm', ' × '.join(f'{b - a:g}' for a, b in zip(box['min'], box['max']))])
    for detector in setup['detectors']:
        columns, rows_of = detector['image_size']
        rows.append([detector['name'].replace('_', ' '),
                     f'{columns} × {rows_of} px of {detector["pixel_pitch_mm"][0]:g} × '
                     f'{detector["pixel_pitch_mm"][1]:g} mm, source at '
                     f'({", ".join(f"{round(v):d}" for v in detector["source_mm"])}) mm, region of '
                     f'{detector["region"][2]} × {detector["region"][3]} px'])
    rows += [[key, ', '.join(map(str, value)) if isinstance(value, list) else value]
             for key, value in run['settings'].items()]
    return [html.heading('Settings, versions, hashes'),
            html.table(['', ''], rows, number('Table'),
                       'What was evaluated by what. The hash of several files is that of what sha256sum prints of them, '
                       'names without folders, in the order of the table of frames (images) or of their names (CT).')]


def write(folder):
    """Writes report.html into a results folder. @return its path"""
    results, parts = sections(folder)
    path = os.path.join(folder, 'report.html')
    with open(path + '.partial', 'w', encoding='utf-8') as file:
        file.write(html.page(f'{results.name}: target tracking', parts))
    os.replace(path + '.partial', path)
    return path
