#!/usr/bin/env python3
"""The workflow with programs that only leave traces: a run that is killed goes on where it was."""
import json
import os
import shutil
import signal
import subprocess
import tempfile
import time
import unittest

import rostest

SNAKEFILE = os.path.join(os.path.dirname(os.path.realpath(__file__)), '..', 'workflow', 'Snakefile')
# The slow one says when it is at work; a second time it is fast.
EVALUATE = '''#!/bin/bash
while [ $# -gt 0 ]; do case "$1" in --methods) method=$2 ;; --out) out=$2 ;; esac; shift; done
mkdir -p "$out"
echo "$out" >>../started
if [ "$method" = tracking ] && [ ! -e ../slow ]; then touch ../slow; sleep 60; fi
echo '{}' >"$out/run.json"
[ "$method" != registration ]  # as if an exposure had no pose
'''
REPORT = '#!/bin/bash\necho report >"$1/report.html"\n'
COHORT = '#!/bin/bash\necho "$@" >../cohort\necho report >report.html\necho "{}" >baseline.json\n'
WORSE = COHORT + 'echo "worse than the baseline: it" >&2\nexit 1\n'


class WorkflowTest(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.mkdtemp()
        self.addCleanup(shutil.rmtree, self.folder)
        self.program('evaluate_sequence', EVALUATE)
        self.program('write_report', REPORT)
        self.program('write_cohort_report', COHORT)
        for name in ('a', 'b b'):
            os.makedirs(self.path('data/' + name))
            self.write('data/' + name + '/sequence.yaml', '')
        self.write('cohort.json', json.dumps({
            'programs': self.path('programs'), 'methods': ['registration', 'tracking'],
            'sequences': {name: self.path('data/' + name) for name in ('a', 'b b')}}))

    def path(self, name):
        return os.path.join(self.folder, name)

    def write(self, name, text):
        os.makedirs(os.path.dirname(self.path(name)), exist_ok=True)
        with open(self.path(name), 'w', encoding='utf-8') as file:
            file.write(text)

    def program(self, name, text):
        self.write('programs/' + name, text)
        os.chmod(self.path('programs/' + name), 0o755)

    def start(self, *arguments):
        return subprocess.Popen(
            ['snakemake', '--snakefile', SNAKEFILE, '--directory', self.path('out'), '--configfile',
             self.path('cohort.json'), '--cores', '1', '--quiet', *arguments], start_new_session=True,
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)

    def started(self):
        with open(self.path('started'), encoding='utf-8') as file:
            return sorted(file.read().splitlines())

    def test_a_killed_run_goes_on(self):
        run = self.start()
        deadline = time.monotonic() + 40.0
        while not os.path.exists(self.path('slow')):
            self.assertLess(time.monotonic(), deadline, 'the slow job did not begin')
            time.sleep(0.1)
        os.killpg(run.pid, signal.SIGKILL)
        run.communicate()
        cut_off = self.started()
        self.start('--unlock').communicate()
        self.program('write_cohort_report', WORSE)
        again = self.start('--rerun-incomplete')
        _, messages = again.communicate(timeout=60)
        jobs = [f'{name}/{method}' for name in ('a', 'b b') for method in ('registration', 'tracking')]
        # Once each, and the one that was cut off twice.
        slow = [job for job in jobs if self.started().count(job) == 2]
        self.assertEqual(1, len(slow), self.started())
        self.assertIn(slow[0], cut_off)
        self.assertEqual(sorted(jobs + slow), self.started())
        with open(self.path('cohort'), encoding='utf-8') as file:
            self.assertEqual('. a b b', file.read().strip())
        for name in ('report.html', 'a/report.html', 'b b/report.html', 'baseline.json'):
            self.assertTrue(os.path.exists(self.path('out/' + name)), name)
        # What is worse than the baseline is an error, after all reports have been written.
        self.assertNotEqual(0, again.returncode)
        self.assertIn('worse than the baseline: it', messages)


if __name__ == '__main__':
    rostest.rosrun('xray_tracking_tools', 'workflow', WorkflowTest)
