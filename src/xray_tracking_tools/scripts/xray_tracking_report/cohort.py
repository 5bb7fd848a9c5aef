"""The report of several sequences."""
import json
import os

import numpy

from . import baseline, figures, findings, html, pictures, report, statistics
from .report import Numbering
from .results import ResultsError, Results, UNCORRECTED, read_json


def write(folders, out, baseline_path):
    """Writes report.html, and baseline.json for later runs. @return what is worse than in the baseline, in words"""
    all_results = [Results(folder) for folder in folders]
    names = [results.name for results in all_results]
    for name in names:
        if names.count(name) > 1:
            raise ResultsError(f'two folders have results of a sequence called {name}, expected names that differ')
    now = baseline.figures_of(all_results)
    changes = baseline.changes(read_json(baseline_path), now) if baseline_path else None
    parts = sections(all_results, changes)
    os.makedirs(out, exist_ok=True)
    with open(os.path.join(out, 'baseline.json'), 'w', encoding='utf-8') as file:
        json.dump(now, file, indent=1, sort_keys=True)
        file.write('\n')
    path = os.path.join(out, 'report.html')
    with open(path + '.partial', 'w', encoding='utf-8') as file:
        file.write(html.page(f'Target tracking in {len(names)} sequences', parts))
    os.replace(path + '.partial', path)
    return [change.words() for change in changes or () if change.worse]


def sections(all_results, changes):
    number = Numbering()
    with_gold = [r for r in all_results if r.has_gold]
    frames = sum(r.frames - 1 for r in with_gold)
    parts = [html.heading(f'Target tracking in {len(all_results)} sequences', 1), html.paragraph(
        f'{sum(r.frames for r in all_results)} exposures. {len(with_gold)} sequences have a gold standard: their '
        f'{frames} exposures after the first ones are judged by the target registration error (TRE), the root mean '
        'square distance over the target’s box between where the estimated and the true pose put it.', class_='lead')]
    if with_gold:
        parts += findings_section(with_gold, number) + pooled(with_gold, number)
    if changes is not None:
        parts += comparison(changes, with_gold, number)
    for results in all_results:
        parts += one_sequence(results, number)
    return parts + report.provenance(all_results[0], number)


def findings_section(with_gold, number):
    rows = [[f.claim, f.who, html.verdict(f.held), html.probability(f.p), f.figures] for f in findings.judge(with_gold)]
    return [html.heading('The paper’s findings'), html.table(
        ['finding', 'of', '', 'P', 'figures'], rows, number('Table'),
        'Findings of Rohlfing et al., VMV 2004, section 3, on these sequences, pooled over frames. Held: significant at P '
        '< 0.05 in the direction of the finding; where it says that two do not differ: not significant. “As published” '
        'are the paper’s own methods, run on the same images. Frames of a sequence are not independent: small samples '
        'with a P near 0.05 say less than they seem to.')]


def pooled_errors(with_gold):
    """{method: errors of all frames}, for the methods that all sequences have, so that rows can be compared."""
    common = [m for m in with_gold[0].methods if all(m in r.methods for r in with_gold)]
    return {m: numpy.concatenate([r.methods[m].judged_tre() for r in with_gold]) for m in common}


def pooled(with_gold, number):
    errors = pooled_errors(with_gold)
    rows = [report.summary_row(name, values, sum(r.methods[name].lost() for r in with_gold),
                               sum(r.methods[name].failed() for r in with_gold)) for name, values in errors.items()]
    names = [r.name for r in with_gold]
    by_sequence = []
    for results in with_gold:
        quantiles = {name: statistics.quantiles(m.judged_tre()) for name, m in results.methods.items()}
        by_sequence.append({name: (q['median'], q['p95']) for name, q in quantiles.items() if q})
    parts = [html.heading('All sequences together'),
             report.summary_table(rows, number('Table'), 'TRE in mm of all judged frames together.'),
             html.figure(figures.box_and_whisker(list(errors.items()), 'TRE (mm)'), number('Figure'),
                         'TRE of all judged frames: box from the 25th to the 75th percentile, whiskers to the least and '
                         'the largest, square: median, bar: mean. (The paper’s figure 5.)'),
             html.table(report.COMPARISON_HEAD, report.comparison_rows(errors), number('Table'),
                        report.COMPARISON_CAPTION),
             html.figure(figures.medians_by_sequence(names, by_sequence), number('Figure'),
                         'Median TRE by sequence and method, with a line to the 95th percentile.')]
    methods = list(dict.fromkeys(name for r in with_gold for name in r.methods))
    table = []
    for results in with_gold:
        cells = []
        for name in methods:
            method = results.methods.get(name)
            values = statistics.quantiles(method.judged_tre()) if method else None
            text = f'{values["median"]:.3f} / {values["p95"]:.3f}' if values else '–'
            missing = method.lost() + method.failed() if method and values else 0
            cells.append(text + (f', {missing} lost' if missing else ''))
        table.append([results.name] + cells)
    parts.append(html.table(['sequence'] + [figures.line_label(m) for m in methods], table, number('Table'),
                            'Median / 95th percentile of the TRE in mm.'))
    times = cohort_times(with_gold, methods, number)
    return parts + times


def cohort_times(with_gold, methods, number):
    rows = []
    for name in methods:
        values = [1e3 * r.methods[name].cpu[1:] for r in with_gold if name in r.methods]
        quantiles = statistics.quantiles(numpy.concatenate(values)) if name != UNCORRECTED else None
        if quantiles and quantiles['max'] > 0.0:
            rows.append([html.method_cell(name), quantiles['n'], html.mm(quantiles['median'], 1),
                         html.mm(quantiles['mean'], 1), html.mm(quantiles['p95'], 1), html.mm(quantiles['max'], 1)])
    if not rows:
        return []
    return [html.table(['method', 'n', 'median, ms', 'mean', '95 %', 'max'], rows, number('Table'),
                       'Processor time of a frame, all cores together, first frames left out. (The paper’s figure 7.)')]


def comparison(changes, with_gold, number):
    worse = [change for change in changes if change.worse]
    parts = [html.heading('Against the stored baseline')]
    limits = f'more than {100 * baseline.WORSE_SHARE:.0f} % or {baseline.WORSE_MM} mm'
    known = {change.sequence for change in changes}
    new = [r.name for r in with_gold if r.name not in known]
    text = f'{len(changes)} figures of {len(known)} sequences were compared. '
    if not changes:
        return parts + [html.paragraph('The baseline has none of these sequences.', class_='warning')]
    if worse:
        rows = [[c.sequence, html.method_cell(c.method), c.what, str(c.before), str(c.now)] for c in worse]
        parts.append(html.paragraph(f'{text}{len(worse)} are worse by {limits}.', class_='warning'))
        parts.append(html.table(['sequence', 'method', 'figure', 'baseline', 'now'], rows, number('Table'),
                                'What is worse.'))
    else:
        parts.append(html.paragraph(f'{text}None is worse by {limits}.'))
    if new:
        parts.append(html.paragraph('Not in the baseline: ' + ', '.join(new) + '.'))
    return parts


def one_sequence(results, number):
    parts = [html.heading(results.name), html.paragraph(
        f'{results.frames} exposures. ' + ('' if results.has_gold else 'No gold standard.'))]
    if results.has_gold:
        rows = [report.summary_row(name, m.judged_tre(), m.lost(), m.failed()) for name, m in results.methods.items()]
        parts.append(html.table(report.SUMMARY_HEAD, rows, number('Table'), f'TRE in mm, {results.name}.'))
        parts.append(html.figure(
            figures.errors_over_frames(results.estimating, results.methods[UNCORRECTED].tre), number('Figure'),
            f'TRE over frames, {results.name}; dotted: uncorrected; crosses above: frames without a pose.'))
    else:
        parts += report.without_gold(results, number)
    gallery = pictures.gallery(results, 'worst') if results.has_gold else pictures.gallery(results, 'last')
    if gallery:
        what = 'Worst' if results.has_gold else 'Last'
        _, run = pictures.best_run(results)
        parts += [gallery, html.paragraph(
            f'{what} frame by {figures.line_label(run["pictures_of"])}. {report.pictures_legend(results)}',
            class_='caption')]
    return parts
