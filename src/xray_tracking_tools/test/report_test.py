#!/usr/bin/env python3
"""The reports' statistics against closed forms, and what reports say of results that are made up."""
import itertools
import json
import math
import os
import shutil
import subprocess
import sys
import tempfile
import unittest

import numpy
import rostest
from scipy.spatial.transform import Rotation

HERE = os.path.dirname(os.path.realpath(__file__))
SCRIPTS = os.path.join(HERE, '..', 'scripts')
sys.path.insert(0, SCRIPTS)
from xray_tracking_report import baseline, cohort, figures, findings, report, results, statistics, trust  # noqa: E402

BOX = (numpy.array([-24.0, -8.0, -11.0]), numpy.array([26.0, 39.0, 13.0]))
UPPER = [(i, j) for i in range(6) for j in range(i, 6)]


def write_results(folder, methods, uncorrected, gold=True, times=True, name='made up'):
    """A results folder as evaluate_sequence writes it. methods: {name: errors}, NaN for a lost exposure."""
    os.makedirs(folder)
    def write(file_name, lines):
        with open(os.path.join(folder, file_name), 'w', encoding='utf-8') as file:
            file.write('\n'.join(lines) + '\n')
    tre = ['frame,stamp_s,method,tre_mm,uncorrected_mm,translation_error_mm,rotation_error_deg,status,cpu_s,wall_s']
    poses = ['frame,stamp_s,method,tx_mm,ty_mm,tz_mm,qx,qy,qz,qw']
    exposures = ['frame,stamp_s,method,source,reason,gate,gate_text,disagreement_px,chi_square,degrees_of_freedom,' +
                 ','.join(f'c{i + 1}{j + 1}' for i, j in UPPER)]
    taken = ['frame,stamp_s,method,cpu_s,wall_s,registration_cpu_s']
    truth = ['frame,stamp_s,tx_mm,ty_mm,tz_mm,qx,qy,qz,qw']
    covariance = ','.join('0.01' if i == j else '0' for i, j in UPPER)
    for k, motion in enumerate(uncorrected):
        truth.append(f'{k},{0.1 * k:.9f},{motion},0,0,0,0,0,1')
        if gold:
            tre.append(f'{k},{0.1 * k:.9f},uncorrected,{motion},{motion},{motion},0,ok,,')
        for method, errors in methods.items():
            error = errors[k]
            known = numpy.isfinite(error)
            value = f'{error}' if known and gold else ''
            tre.append(f'{k},{0.1 * k:.9f},{method},{value},{motion if gold else ""},{value},,'
                       f'{"ok" if known else "lost"},,')
            pose = f'{motion + error},0,0,0,0,0,1' if known else ',,,,,,'
            poses.append(f'{k},{0.1 * k:.9f},{method},{pose}')
            exposures.append(f'{k},{0.1 * k:.9f},{method},{"tracked" if known else "none"},'
                             f'"{"" if known else "the <views>, both, differ"}",{"NONE" if k else "CONFIRMING"},"as it '
                             f'is",{0.1 + 0.01 * k},1,1,{covariance if known else "," * 20}')
            taken.append(f'{k},{0.1 * k:.9f},{method},{0.01 + 0.001 * (k % 3)},0.02,'
                         f'{0.004 + 0.001 * (k % 3) if method != "registration" else 0.009 + 0.001 * (k % 2)}')
    write('tre.csv', tre)
    write('poses.csv', poses)
    write('exposures.csv', exposures)
    if times:
        write('times.csv', taken)
    if gold:
        write('gold_standard.csv', truth)
    write('summary.json', [json.dumps({'sequence': name, 'frames': len(uncorrected)})])
    write('run.json', [json.dumps({
        'program': {'version': '1', 'revision': 'r', 'compiler': 'c', 'OpenCV': 'o', 'Eigen': 'e', 'Boost': 'b'},
        'processor': 'p', 'source': 's', 'methods': list(methods), 'inputs': [], 'settings': {}, 'pictures': [],
        'pictures_of': next(iter(methods)),
        'setup': {'target_box_mm': {'min': list(BOX[0]), 'max': list(BOX[1])}, 'detectors': []}})])


class Folder(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.mkdtemp()
        self.addCleanup(shutil.rmtree, self.folder)

    def path(self, name):
        return os.path.join(self.folder, name)

    def text_of(self, name):
        with open(report.write(self.path(name)), encoding='utf-8') as file:
            return file.read()


class Statistics(unittest.TestCase):
    def test_paired_t_test_is_the_closed_form(self):
        # Differences 1 to 5: mean 3, standard deviation sqrt(2.5), t = 3 sqrt(2), four degrees of freedom, of which
        # Student's distribution function is elementary.
        b = numpy.array([0.3, -1.0, 2.0, 8.0, 0.1, 5.0])
        a = b + numpy.array([4.0, 1.0, 5.0, 2.0, 3.0, numpy.nan])
        c = statistics.paired(a, b)
        t = 3.0 * math.sqrt(2.0)
        s = t / math.sqrt(1.0 + t * t / 4.0)
        distribution = 0.5 + 3.0 / 8.0 * s * (1.0 - s * s / 12.0)
        self.assertEqual(5, c.n)
        self.assertAlmostEqual(3.0, c.mean, 12)
        self.assertAlmostEqual(t, c.t, 10)
        self.assertAlmostEqual(2.0 * (1.0 - distribution), c.p, 10)
        self.assertAlmostEqual(3.0 / math.sqrt(2.5), c.effect, 12)
        self.assertAlmostEqual(3.0 - 2.776445105 * math.sqrt(0.5), c.low, 7)  # the 97.5 % point of tables
        self.assertAlmostEqual(3.0 + 2.776445105 * math.sqrt(0.5), c.high, 7)

    def test_paired_t_test_of_few_and_of_equal_ones(self):
        self.assertTrue(math.isnan(statistics.paired([1.0, numpy.nan], [0.0, 1.0]).p))
        self.assertEqual((0.0, 1.0), (statistics.paired([1, 2], [1, 2]).t, statistics.paired([1, 2], [1, 2]).p))
        self.assertEqual((math.inf, 0.0), (statistics.paired([2, 3], [1, 2]).t, statistics.paired([2, 3], [1, 2]).p))

    def test_interval_of_a_share_where_it_is_elementary(self):
        low, high = statistics.share_interval(20, 20)
        self.assertAlmostEqual(0.025 ** (1.0 / 20.0), low, 10)
        self.assertEqual(1.0, high)
        self.assertAlmostEqual(1.0 - 0.025 ** (1.0 / 20.0), statistics.share_interval(0, 20)[1], 10)

    def test_errors_drawn_from_a_covariance_fit_it(self):
        # The covariance is of the origin, 400 mm from the centre: a wrong Jacobian would be seen at once.
        generator = numpy.random.default_rng(1)
        frames = 600
        centre = numpy.array([30.0, -250.0, 310.0])
        factor = generator.normal(size=(6, 6)) * numpy.array([0.3] * 3 + [0.002] * 3)[:, None]
        covariance = factor @ factor.T
        method = results.Method('made up', frames)
        gold = results.Poses(frames)
        pose = Rotation.from_rotvec([0.4, -1.1, 0.7])
        for k in range(frames):
            error = factor @ generator.normal(size=6)
            gold.set(k, [1.0, 2.0, 3.0], pose)
            method.poses.set(k, gold.translation[k] + error[:3], Rotation.from_rotvec(error[3:]) * pose)
            method.covariance[k] = covariance
        errors = results.errors_by_axis(method, gold, centre)
        for freedom, nees in zip((3, 6), statistics.normalised_errors(method, gold, centre, errors)):
            c = statistics.calibration(nees, freedom)
            # Standard deviations of the mean of chi-squares and of a share; four of them.
            self.assertLess(abs(c.mean - freedom), 4.0 * math.sqrt(2.0 * freedom / frames))
            self.assertLess(abs(c.within / frames - 0.95), 4.0 * math.sqrt(0.95 * 0.05 / frames))
            wrong = statistics.calibration(nees * 4.0, freedom)  # standard deviations half as large as they are
            self.assertLess(wrong.high, 0.95)

    def test_bound_of_a_probability_where_it_is_elementary(self):
        self.assertAlmostEqual(1.0 - 0.05 ** (1.0 / 3000.0), trust.upper_bound(0, 3000), 12)
        self.assertAlmostEqual(0.95 ** (1.0 / 7.0), trust.upper_bound(6, 7), 12)  # all seven wrong: 0.95
        self.assertEqual((1.0, 1.0), (trust.upper_bound(0, 0), trust.upper_bound(4, 4)))

    def test_errors_are_along_and_about_the_room_axes(self):
        method, gold = results.Method('a', 1), results.Poses(1)
        pose = Rotation.from_rotvec([0.4, -1.1, 0.7])
        gold.set(0, [5.0, 6.0, 7.0], pose)
        turn = numpy.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # 90 degrees about room z
        centre = pose.inv().apply([10.0, 0.0, 0.0])
        method.poses.set(0, [5.0, 6.0, 7.5], Rotation.from_rotvec([0.0, 0.0, math.pi / 2.0]) * pose)
        translation, rotation = results.errors_by_axis(method, gold, centre)
        numpy.testing.assert_allclose(translation[0], turn @ [10.0, 0.0, 0.0] - [10.0, 0.0, -0.5], atol=1e-9)
        numpy.testing.assert_allclose(rotation[0], [0.0, 0.0, 90.0], atol=1e-9)

    def test_distance_of_poses_is_the_mean_over_the_box(self):
        # Gauss and Legendre's two points an axis integrate a quadratic exactly.
        a, b = results.Method('a', 1), results.Method('b', 1)
        a.poses.set(0, [3.0, -1.0, 2.0], Rotation.from_rotvec([0.1, 0.2, -0.1]))
        b.poses.set(0, [0.0, 0.0, 0.0], Rotation.from_quat([0.0, 0.0, 0.0, 1.0]))
        middle, half = (BOX[0] + BOX[1]) / 2.0, (BOX[1] - BOX[0]) / 2.0
        points = [middle + half * numpy.array(signs) / math.sqrt(3.0) for signs in
                  itertools.product((-1.0, 1.0), repeat=3)]
        squares = [((a.poses.of(p)[0] - b.poses.of(p)[0]) ** 2).sum() for p in points]
        self.assertAlmostEqual(math.sqrt(numpy.mean(squares)), results.box_distance(a.poses, b.poses, BOX)[0], 9)

    def test_thinned_curves_keep_extremes_and_gaps(self):
        values = numpy.sin(numpy.arange(6000.0))
        values[1234] = 50.0
        values[3000:3100] = numpy.nan
        frames, kept = figures._thinned(values)
        self.assertLess(len(kept), 2 * figures.POINTS)
        self.assertEqual(50.0, numpy.nanmax(kept))
        self.assertTrue(numpy.isnan(kept).any())
        self.assertTrue((numpy.diff(frames) > 0).all())


class Trust(Folder):
    def test_covariance_is_judged_by_source(self):
        # The covariance is 0.01 along all of the pose; carried to the box's centre c the shift along x has the variance
        # 0.01 (1 + c_y^2 + c_z^2), and correlations with rotations, of which none is off.
        errors = [0.0, 0.1, -0.2, 0.4, math.nan]
        write_results(self.path('a'), {'tracking': errors}, [0.0, 1.0, 2.0, 3.0, 4.0])
        answers = trust.answers(self.path('a'))['tracking']
        self.assertEqual(['tracked'] * 3 + ['none'], answers.source)
        self.assertTrue(answers.open.all())
        # Of the pose it is e^2 / 0.01, wherever the covariance is taken.
        numpy.testing.assert_allclose(answers.nees6[:3], [1.0, 4.0, 16.0], rtol=1e-9)
        self.assertIsNone(trust.calibration_row([answers], 'registered'))
        centre, pose = trust.calibration_row([answers, answers], 'tracked')
        self.assertEqual((6, 6), (centre.n, pose.n))
        self.assertAlmostEqual(7.0, pose.mean, 9)
        self.assertEqual(4, pose.within)  # 16 is beyond chi-square's 12.6
        told = subprocess.run([os.path.join(SCRIPTS, 'judge_trust'), self.path('a')], capture_output=True, text=True,
                              check=True).stdout
        self.assertIn('| a, tracking | tracked | 3 |', told)
        self.assertIn('| 7.00 | 67 %', told)
        write_results(self.path('b'), {'tracking': errors}, [0.0, 1.0, 2.0, 3.0, 4.0], gold=False)
        refused = subprocess.run([os.path.join(SCRIPTS, 'judge_trust'), self.path('b')], capture_output=True, text=True,
                                 check=False)
        self.assertEqual(1, refused.returncode)
        self.assertIn('no gold standard', refused.stderr)


class Reports(Folder):
    def test_says_all_and_stays_small_for_a_long_recording(self):
        generator = numpy.random.default_rng(2)
        frames = 6000
        motion = 5.0 * numpy.abs(numpy.sin(numpy.arange(frames) / 300.0))
        tracking = 0.5 + 0.1 * generator.random(frames)
        tracking[[7, 8, 9, 4000]] = numpy.nan
        write_results(self.path('r'), {'tracking': tracking, 'registration': 0.1 + 0.1 * generator.random(frames)},
                      motion, name='<script>alert(1)</script>')
        text = self.text_of('r')
        for words in ('Target registration error', 'Translation and rotation', 'Covariance against error',
                      'Processor time', 'Beam gate', 'Settings, versions, hashes', '7–9, 4000',
                      'the &lt;views&gt;, both, differ', '&lt;script&gt;', '82 %', '96 %', '<svg'):
            self.assertIn(words, text)
        self.assertNotIn('<script', text)
        self.assertNotRegex(text, r'(src|href)="(?!data:|#)')  # self-contained
        self.assertLess(len(text), 1500000)

    def test_figures_have_ids_of_their_own(self):
        write_results(self.path('r'), {'tracking': [0.0, 0.2, 0.3]}, [0.0, 1.0, 2.0])
        text = self.text_of('r')
        ids = [part.split('"')[0] for part in text.split(' id="')[1:]]
        self.assertGreater(len(ids), 50)
        self.assertEqual(len(ids), len(set(ids)))

    def test_without_a_gold_standard_there_are_no_errors(self):
        write_results(self.path('r'), {'tracking': [0.0, 0.2, 0.3], 'registration': [0.0, 0.1, numpy.nan]},
                      [0.0, 1.0, 2.0], gold=False)
        text = self.text_of('r')
        for words in ('Agreement of the views', 'Agreement of the methods', 'Beam gate'):
            self.assertIn(words, text)
        for words in ('Target registration error', 'NEES', 'uncorrected', 'nan'):
            self.assertNotIn(words, text)

    def test_methods_in_folders_of_their_own_are_put_together(self):
        for method in ('tracking', 'registration'):
            write_results(self.path('r/' + method), {method: [0.0, 0.2, 0.3]}, [0.0, 1.0, 2.0])
        self.assertEqual({'uncorrected', 'registration', 'tracking'}, set(results.Results(self.path('r')).methods))
        write_results(self.path('r/other'), {'other': [0.0, 0.2]}, [0.0, 1.0])
        with self.assertRaisesRegex(results.ResultsError, 'exposures are not the'):
            results.Results(self.path('r'))

    def test_a_single_exposure_is_not_judged(self):
        write_results(self.path('r'), {'tracking': [0.0]}, [0.0])
        text = self.text_of('r')
        self.assertIn('nothing is judged', text)
        self.assertNotIn('Target registration error<', text)

    def test_results_that_never_have_a_pose(self):
        write_results(self.path('r'), {'tracking': [numpy.nan] * 3}, [0.0, 1.0, 2.0])
        self.assertIn('no pose', self.text_of('r'))

    def test_files_that_are_not_results_are_named(self):
        """Cut off, of other columns, bytes, other JSON: the command says which, and is no traceback."""
        def first_field(value):
            return lambda text: text.replace('\n0,', f'\n{value},', 1)
        bad = {
            'tre.csv': ['', 'frame,stamp_s\n0,0\n', '\x00\x01\n', lambda text: text[:-30], first_field('1e9'),
                        first_field('-1'), first_field('nan'), first_field('0.5'), first_field('x'), first_field(''),
                        lambda text: text.replace('0,0.000000000,', '3,0.000000000,', 1),
                        lambda text: text.replace(',1.0,', ',one,', 1)],
            'poses.csv': ['frame,stamp_s\n0,0\n', lambda text: text[:-3], first_field('99'),
                          lambda text: text.replace(',0,0,0,1\n', ',0,0,0,0\n', 1)],
            'exposures.csv': [first_field('99'), lambda text: text.replace('gate_text', 'words')],
            'times.csv': ['frame,stamp_s\n0,0\n'],
            'gold_standard.csv': [first_field('99')],
            'summary.json': ['', '[1]', 'null', '{"sequence"'],
            'run.json': ['null', '"x"'],
        }
        write_results(self.path('good'), {'tracking': [0.0, 1.0, 1.0]}, [0.0, 1.0, 2.0])
        report.write(self.path('good'))
        for name, contents in bad.items():
            with open(os.path.join(self.path('good'), name), encoding='utf-8') as file:
                text = file.read()
            for content in contents:
                changed = content if isinstance(content, str) else content(text)
                self.assertNotEqual(changed, text)
                shutil.rmtree(self.path('bad'), ignore_errors=True)
                shutil.copytree(self.path('good'), self.path('bad'))
                with open(os.path.join(self.path('bad'), name), 'w', encoding='utf-8') as file:
                    file.write(changed)
                with self.subTest(name=name, content=changed):
                    with self.assertRaisesRegex(results.ResultsError, name):
                        report.write(self.path('bad'))

    def test_command_names_what_is_missing(self):
        done = subprocess.run([os.path.join(SCRIPTS, 'write_report'), self.folder], capture_output=True, text=True)
        self.assertEqual(1, done.returncode)
        self.assertIn('no tre.csv', done.stderr)
        self.assertEqual(1, done.stderr.count('\n'))


class Cohorts(Folder):
    def cohort(self, paper_registration, registration, tracking, combined):
        """Two sequences of 31 exposures; arguments: errors early and late."""
        generator = numpy.random.default_rng(3)
        found = []
        for i in range(2):
            def errors(early, late):
                return numpy.concatenate([[0.0], numpy.linspace(early, late, 30)]) + 0.02 * generator.random(31)
            write_results(self.path(f's{i}'), {
                'paper_registration': errors(*paper_registration), 'paper_tracking': errors(0.4, 0.8),
                'registration': errors(*registration), 'tracking': errors(*tracking),
                'tracking_and_registration': errors(*combined)}, numpy.linspace(0.0, 8.0, 31), name=f's{i}')
            found.append(results.Results(self.path(f's{i}')))
        return {(f.claim, f.who): f.held for f in findings.judge(found)}

    def test_findings_hold_where_they_do(self):
        held = self.cohort((0.9, 2.5), (0.5, 0.9), (0.1, 0.6), (0.1, 0.11))
        self.assertTrue(all(value for key, value in held.items() if 'do not differ' not in key[0]), held)
        self.assertFalse(held['Tracking and tracking + registration do not differ', 'this project'])

    def test_findings_do_not_hold_where_they_do_not(self):
        held = self.cohort((9.0, 9.0), (0.05, 0.05), (0.35, 0.3), (0.1, 0.5))
        for key in (('It corrects motion', 'registration as published'),
                    ('Tracking is better than registration alone', 'this project'),
                    ('Tracking + registration is better than registration alone', 'this project'),
                    ('Tracking drifts in late frames', 'this project'),
                    ('Tracking + registration stays stable in late frames', 'this project'),
                    ('Registration alone is worst in frames with large motion', 'this project')):
            self.assertIs(held[key], False, key)

    def test_a_method_that_was_not_run_is_not_judged(self):
        write_results(self.path('s'), {'tracking': [0.0, 0.2, 0.3]}, [0.0, 1.0, 2.0])
        held = {f.claim + f.who: f.held for f in findings.judge([results.Results(self.path('s'))])}
        self.assertIsNone(held['Registration is faster after tracking' + 'this project'])

    def test_what_is_a_regression(self):
        for before, now, worse in ((1.0, 1.0199, False), (1.0, 1.0201, True), (0.1, 0.1099, False), (0.1, 0.1101, True),
                                   (0.1, 0.05, False), (0.1, None, True), (None, 0.1, False), (None, None, False)):
            self.assertIs(baseline.is_worse(before, now), worse, (before, now))

    def test_baseline_is_compared_with(self):
        write_results(self.path('good'), {'tracking': [0.0, 0.2, 0.3]}, [0.0, 1.0, 2.0])
        write_results(self.path('lost'), {'tracking': [0.0, 0.2, numpy.nan]}, [0.0, 1.0, 2.0])
        write_results(self.path('worse'), {'tracking': [0.0, 0.26, 0.36]}, [0.0, 1.0, 2.0])
        write_results(self.path('other'), {'registration': [0.0, 0.2, 0.3]}, [0.0, 1.0, 2.0])
        self.assertEqual([], cohort.write([self.path('good')], self.path('out'), None))
        stored = self.path('out/baseline.json')
        now = {name: baseline.figures_of([results.Results(self.path(name))]) for name in
               ('good', 'lost', 'worse', 'other')}
        before = results.read_json(stored)
        self.assertEqual(before, now['good'])
        def worse(name):
            return ' '.join(change.words() for change in baseline.changes(before, now[name]) if change.worse)
        self.assertEqual('', worse('good'))
        self.assertIn('without a pose was 0, is 1', worse('lost'))
        self.assertIn('median (mm) was 0.25, is 0.31', worse('worse'))
        self.assertIn('the method was there, is missing', worse('other'))
        with self.assertRaisesRegex(results.ResultsError, 'two folders'):
            cohort.write([self.path('good'), self.path('lost')], self.path('out'), None)
        done = subprocess.run([os.path.join(SCRIPTS, 'write_cohort_report'), self.path('again'), self.path('worse'),
                               '--baseline', stored], capture_output=True, text=True)
        self.assertEqual(1, done.returncode)
        self.assertIn('worse than the baseline: made up, tracking: median', done.stderr)
        self.assertTrue(os.path.exists(self.path('again/report.html')))


if __name__ == '__main__':
    rostest.rosrun('xray_tracking_tools', 'report', '__main__')
