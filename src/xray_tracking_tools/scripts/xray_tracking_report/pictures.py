"""Radiographs with what was found in them."""
import base64
import itertools
import os

import numpy
from markupsafe import Markup

from . import html

# Corners of a box that differ in one coordinate.
EDGES = [(a, b) for a, b in itertools.combinations(range(8), 2) if bin(a ^ b).count('1') == 1]


class Detector:
    def __init__(self, description):
        self.pitch = numpy.array(description['pixel_pitch_mm'], float)
        self.source = numpy.array(description['source_mm'], float)
        self.origin = numpy.array(description['origin_mm'], float)
        self.axes = numpy.array([description['x_direction'], description['y_direction']], float)
        self.region = description.get('region')

    def project(self, points):
        """Pixels of room points [mm], n x 3."""
        normal = numpy.cross(self.axes[0], self.axes[1])
        rays = points - self.source
        scale = ((self.origin - self.source) @ normal) / (rays @ normal)
        on_panel = self.source + rays * scale[:, None] - self.origin
        return on_panel @ self.axes.T / self.pitch


def data_uri(path):
    kind = 'jpeg' if path.endswith('.jpg') else 'png'
    with open(path, 'rb') as file:
        return f'data:image/{kind};base64,' + base64.b64encode(file.read()).decode('ascii')


def box_lines(box, rotation, translation, detector, style):
    corners = numpy.array(list(itertools.product(*zip(*box))), float) @ rotation.T + translation
    seen = detector.project(corners)
    path = ''.join(f'M{seen[a][0]:.1f} {seen[a][1]:.1f}L{seen[b][0]:.1f} {seen[b][1]:.1f}' for a, b in EDGES)
    return f'<path d="{path}" fill="none" vector-effect="non-scaling-stroke" {style}/>'


def picture(results, folder, run, entry, method):
    """One radiograph as a figure."""
    frame = entry['frame']
    x, y, width, height = entry['crop']
    detector = Detector(next(d for d in run['setup']['detectors'] if d['name'] == entry['detector']))
    image = f'<image x="{x}" y="{y}" width="{width}" height="{height}" preserveAspectRatio="none" href="'
    text = f'<svg viewBox="{x} {y} {width} {height}" role="img" aria-label="radiograph">'
    text += image + data_uri(os.path.join(folder, entry['radiograph'])) + '"/>'
    if entry['edges']:
        text += image + data_uri(os.path.join(folder, entry['edges'])) + '"/>'
    region = method.regions.get((frame, entry['detector']))
    if region is not None:
        corners = ' '.join(f'{u:.1f},{v:.1f}' for u, v in region)
        text += (f'<polygon points="{corners}" fill="none" stroke="#fff" stroke-width="1.2" stroke-dasharray="5 3" '
                 'vector-effect="non-scaling-stroke"/>')
    box = results.box()
    poses = method.poses
    if numpy.isfinite(poses.translation[frame]).all():
        text += box_lines(box, poses.rotation[frame], poses.translation[frame], detector,
                          'stroke="#35d07f" stroke-width="1.3"')
    if results.gold is not None:
        text += box_lines(box, results.gold.rotation[frame], results.gold.translation[frame], detector,
                          'stroke="#ff5fd2" stroke-width="1" stroke-dasharray="2 3"')
    text += '</svg>'
    error = method.tre[frame]
    caption = f'{entry["why"]} (frame {frame}), {entry["detector"].replace("_", " ")}'
    if numpy.isfinite(error):
        caption += f', TRE {html.mm(error)} mm'
    elif method.status[frame] != 'ok':
        caption += ', ' + method.status[frame]
    return Markup('<figure>{}<figcaption>{}</figcaption></figure>').format(Markup(text), caption)


def best_run(results):
    """The part whose pictures are of the method shown first; None if there are none."""
    preferred = ('tracking_and_registration', 'registration', 'tracking', 'paper_registration', 'paper_tracking')
    with_pictures = [(folder, run) for folder, run in results.runs if run.get('pictures')]
    return min(with_pictures, default=None, key=lambda part: preferred.index(part[1]['pictures_of']))


def gallery(results, only=None):
    """All pictures, or those shown for the given reason. Empty if there are none."""
    best = best_run(results)
    if best is None:
        return Markup('')
    folder, run = best
    method = results.methods[run['pictures_of']]
    entries = [e for e in run['pictures'] if only is None or only in e['why'].split(', ')]
    order = {name: i for i, name in enumerate(d['name'] for d in run['setup']['detectors'])}
    entries.sort(key=lambda e: (order[e['detector']], e['frame']))
    # A row a view, unless that makes pictures of a page's width.
    columns = len(entries) // len(order) if len(entries) > 2 * len(order) else 4
    return Markup(f'<div class="pictures" style="--columns: {columns}">') + Markup('').join(
        picture(results, folder, run, entry, method) for entry in entries) + Markup('</div>')
