"""What a results folder holds (docs/evaluation.md, "Files"), as arrays."""
import csv
import json
import os

import numpy
from scipy.spatial.transform import Rotation

UNCORRECTED = 'uncorrected'
# The order in which methods are shown; others follow by name.
ORDER = (UNCORRECTED, 'paper_registration', 'registration', 'paper_tracking', 'tracking', 'tracking_and_registration')


class ResultsError(Exception):
    """Names the file and what is wrong with it."""


class Row(dict):
    """Of a table; names file and line where a field is not what it should be."""

    def __init__(self, where, fields):
        super().__init__(fields)
        self.where = where

    def __missing__(self, column):
        raise ResultsError(f'{self.where}: there is no column {column}')

    def number(self, column):
        """NaN for an empty field."""
        try:
            return float(self[column]) if self[column] != '' else numpy.nan
        except ValueError as error:
            raise ResultsError(f"{self.where}: {column} is '{self[column]}', expected a number or nothing") from error

    def frame(self, frames):
        """Index of an exposure, of so many."""
        value = self.number('frame')
        if not (0 <= value < frames and value == int(value)):
            raise ResultsError(f"{self.where}: frame is '{self['frame']}', expected 0 to {frames - 1}")
        return int(value)


def read_table(path):
    """Rows of a CSV file by column."""
    rows = []
    try:
        with open(path, newline='', encoding='utf-8', errors='replace') as file:
            reader = csv.DictReader(file)
            for fields in reader:
                where = f'{path}, line {reader.line_num}'
                if None in fields or None in fields.values():
                    raise ResultsError(f'{where}: expected {len(reader.fieldnames)} fields; is the file cut off?')
                rows.append(Row(where, fields))
    except OSError as error:
        raise ResultsError(f'{path}: {error.strerror}') from error
    except csv.Error as error:
        raise ResultsError(f'{path}: no table: {error}') from error
    return rows


def read_json(path):
    try:
        with open(path, encoding='utf-8') as file:
            content = json.load(file)
    except OSError as error:
        raise ResultsError(f'{path}: {error.strerror}') from error
    except ValueError as error:
        raise ResultsError(f'{path}: {error}') from error
    if not isinstance(content, dict):
        raise ResultsError(f'{path}: expected a JSON object')
    return content


class Poses:
    """room_from_patient of every frame; where there is none, NaN."""

    def __init__(self, frames):
        self.translation = numpy.full((frames, 3), numpy.nan)
        self.quaternion = numpy.full((frames, 4), numpy.nan)  # x, y, z, w
        self.rotation = numpy.full((frames, 3, 3), numpy.nan)

    def set(self, frame, translation, rotation):
        self.translation[frame] = translation
        self.quaternion[frame] = rotation.as_quat()
        self.rotation[frame] = rotation.apply(numpy.eye(3)).T

    def read(self, frame, row):
        values = [row.number(key) for key in ('tx_mm', 'ty_mm', 'tz_mm', 'qx', 'qy', 'qz', 'qw')]
        if numpy.isfinite(values).all():
            try:
                self.set(frame, values[:3], Rotation.from_quat(values[3:]))
            except ValueError as error:
                raise ResultsError(f'{row.where}: qx, qy, qz, qw are {values[3:]}, expected a rotation') from error

    def of(self, point):
        """Where a point of the patient is in every frame [mm]."""
        return self.rotation @ point + self.translation


class Method:
    """One method's answers, an entry a frame."""

    def __init__(self, name, frames):
        self.name = name
        self.poses = Poses(frames)
        self.tre = numpy.full(frames, numpy.nan)
        self.status = ['failed'] * frames
        self.source = [''] * frames
        self.reason = [''] * frames
        self.gate = [''] * frames
        self.gate_text = [''] * frames
        self.disagreement = numpy.full(frames, numpy.nan)
        # Of (translation of the patient frame's origin [mm], rotation vector about room axes [rad]).
        self.covariance = numpy.full((frames, 6, 6), numpy.nan)
        self.cpu = numpy.full(frames, numpy.nan)
        self.registration_cpu = numpy.full(frames, numpy.nan)
        self.regions = {}  # (frame, detector) to the four corners [px]

    def judged_tre(self):
        """Of the frames after the first; NaN where there is no pose."""
        return self.tre[1:]

    def lost(self):
        return sum(status == 'lost' for status in self.status[1:])

    def failed(self):
        return sum(status == 'failed' for status in self.status[1:])


class Results:
    """A results folder, or a folder with one for each method."""

    def __init__(self, folder):
        self.folder = folder
        parts = [folder] if os.path.exists(os.path.join(folder, 'tre.csv')) else sorted(
            entry.path for entry in os.scandir(folder) if os.path.exists(os.path.join(entry.path, 'tre.csv')))
        if not parts:
            raise ResultsError(f'{folder}: no tre.csv in it, expected the results of an evaluation')
        self.methods = {}
        self.gold = None
        self.runs = []      # (folder, run.json) of every part that has one
        self.stamps = None
        for part in parts:
            self._read(part)
        self.methods = {name: self.methods[name] for name in sorted(self.methods, key=_place)}
        if not self.has_gold:
            self.methods.pop(UNCORRECTED, None)

    @property
    def frames(self):
        return len(self.stamps)

    @property
    def has_gold(self):
        return UNCORRECTED in self.methods and numpy.isfinite(self.methods[UNCORRECTED].tre).any()

    @property
    def run(self):
        """run.json of the first part that has one; empty if none has."""
        return self.runs[0][1] if self.runs else {}

    @property
    def estimating(self):
        """The methods without `uncorrected`."""
        return [method for name, method in self.methods.items() if name != UNCORRECTED]

    def box(self):
        """Corners of the target box, patient frame [mm]: least, largest. None if run.json is not there."""
        box = self.run.get('setup', {}).get('target_box_mm')
        return None if box is None else (numpy.array(box['min']), numpy.array(box['max']))

    def _read(self, part):
        path = os.path.join(part, 'tre.csv')
        errors = read_table(path)
        stamps = sorted({(row.frame(len(errors)), row.number('stamp_s')) for row in errors})
        grow = all(before < after for (_, before), (_, after) in zip(stamps, stamps[1:]))
        if not stamps or not grow or [frame for frame, _ in stamps] != list(range(len(stamps))):
            raise ResultsError(f'{path}: expected exposures, with frames from 0 on and stamps that grow')
        stamps = numpy.array([stamp for _, stamp in stamps])
        if self.stamps is None:
            self.stamps = stamps
            self.name = read_json(os.path.join(part, 'summary.json')).get('sequence', os.path.basename(part))
        elif len(stamps) != len(self.stamps) or not numpy.allclose(stamps, self.stamps):
            raise ResultsError(f'{part}: its {len(stamps)} exposures are not the {len(self.stamps)} of the other '
                               f'methods in {self.folder}')
        for row in errors:
            method = self._method(row['method'])
            frame = row.frame(self.frames)
            method.tre[frame] = row.number('tre_mm')
            method.status[frame] = row['status']
            method.cpu[frame] = row.number('cpu_s')
        for row in read_table(os.path.join(part, 'poses.csv')):
            self._method(row['method']).poses.read(row.frame(self.frames), row)
        self._read_further(part)

    def _read_further(self, part):
        """What evaluate_bag does not write."""
        def rows(name):
            path = os.path.join(part, name)
            return read_table(path) if os.path.exists(path) else []
        upper = [(i, j) for i in range(6) for j in range(i, 6)]
        for row in rows('exposures.csv'):
            method = self._method(row['method'])
            frame = row.frame(self.frames)
            for key in ('source', 'reason', 'gate', 'gate_text'):
                getattr(method, key)[frame] = row[key]
            method.disagreement[frame] = row.number('disagreement_px')
            for i, j in upper:
                method.covariance[frame, i, j] = method.covariance[frame, j, i] = row.number(f'c{i + 1}{j + 1}')
        for row in rows('times.csv'):
            method = self._method(row['method'])
            method.cpu[row.frame(self.frames)] = row.number('cpu_s')
            method.registration_cpu[row.frame(self.frames)] = row.number('registration_cpu_s')
        for row in rows('views.csv'):
            corners = numpy.array([[row.number(f'x{i}'), row.number(f'y{i}')] for i in (1, 2, 3, 4)])
            if numpy.isfinite(corners).all():
                self._method(row['method']).regions[row.frame(self.frames), row['detector']] = corners
        for row in rows('gold_standard.csv'):
            if self.gold is None:
                self.gold = Poses(self.frames)
            self.gold.read(row.frame(self.frames), row)
        if os.path.exists(os.path.join(part, 'run.json')):
            self.runs.append((part, read_json(os.path.join(part, 'run.json'))))

    def _method(self, name):
        if name not in self.methods:
            self.methods[name] = Method(name, self.frames)
        return self.methods[name]


def _place(name):
    return (ORDER.index(name) if name in ORDER else len(ORDER), name)


def box_moments(box):
    """Centre of a box and the matrix of its points' second moments about it."""
    low, high = box
    return (low + high) / 2.0, numpy.diag((high - low) ** 2 / 12.0)


def box_distance(a, b, box):
    """Root mean square distance over the target box between two methods' poses, in every frame [mm]."""
    centre, moments = box_moments(box)
    shift = a.of(centre) - b.of(centre)
    turn = a.rotation - b.rotation
    spread = numpy.einsum('nij,jk,nik->n', turn, moments, turn)
    return numpy.sqrt((shift ** 2).sum(axis=1) + spread)


def errors_by_axis(method, gold, centre):
    """Translation of the target's centre [mm] and rotation [degrees] from the gold standard, room axes; n x 3 each."""
    translation = method.poses.of(centre) - gold.of(centre)
    rotation = numpy.full_like(translation, numpy.nan)
    known = numpy.isfinite(translation).all(axis=1)
    if known.any():
        turn = Rotation.from_quat(method.poses.quaternion[known]) * Rotation.from_quat(gold.quaternion[known]).inv()
        rotation[known] = numpy.degrees(turn.as_rotvec())
    return translation, rotation
