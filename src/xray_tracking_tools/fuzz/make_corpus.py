#!/usr/bin/env python3
"""Writes what the fuzzers of this folder start from: small inputs that the readers take, a folder of them for each
reader. Inputs that a fuzzer found lie beside them, with names that say what was wrong with them; they stay."""
import argparse
import importlib.machinery
import importlib.util
import json
import os
import shutil
import struct
import tempfile
import xmlrpc.client
import zlib

import numpy
import PIL.Image
import pydicom

HERE = os.path.dirname(os.path.abspath(__file__))

DETECTORS = '''detectors:
- name: detector_a
  image_size: [8, 6]
  pixel_pitch_mm: [30.0, 30.0]
  source_mm: [0.0, -1000.0, 0.0]
  origin_mm: [-105.0, 500.0, 75.0]
  x_direction: [1.0, 0.0, 0.0]
  y_direction: [0.0, 0.0, -1.0]
- name: detector_b
  image_size: [8, 6]
  pixel_pitch_mm: [30.0, 30.0]
  source_mm: [1000.0, 0.0, 0.0]
  origin_mm: [-500.0, -105.0, 75.0]
  x_direction: [0.0, 1.0, 0.0]
  y_direction: [0.0, 0.0, -1.0]
'''
POSE = 'initial_pose: {translation_mm: [1.5, -2.0, 3.0], rotation_xyzw: [0, 0, 0, 1]}\n'
BOX = 'target_box_mm: {min: [-10.0, -10.0, -10.0], max: [10.0, 10.0, 10.0]}\n'
DISTORTED = DETECTORS.replace('- name: detector_b', '  distortion: {model: plumb_bob, coefficients: [-0.01, 0.001, 0, 0, 0]}'
                              '\n- name: detector_b')
SEQUENCES = {
    'table': 'ct: ct.nrrd\nframes: frames.csv\ngold_standard: gold_standard.csv\n'
             'intensity: {kind: counts, offset: 10, air_counts: 40000}\nregions: {detector_a: {x_offset: 1, y_offset: 1, width: 4, height: 3}}\n'
             + DETECTORS + POSE + BOX,
    'patterns': 'frames: {rate: 15, files: {detector_a: "a_*.png", detector_b: "b_[0-9].png"}}\n'
                'intensity: {kind: attenuation}\npairing_tolerance: 0.01\nct_content: bone_in_air\n' + DISTORTED + POSE + BOX,
    'bad_target_is_missing': 'ct: ct\nct_series: 1.2.3\nct_nifti_form: sform\nframes: frames.csv\n'
              'target: {rtstruct: structures.dcm, roi: C4}\ndetectors: detectors.yaml\n' + POSE,
}
PARAMETERS = {
    'tracker': '{model: affine, points: 200, resolution: 0.5, ranges: [8, 4.0, 2], whole_region: true, '
               'region: {x_offset: 1, y_offset: 1, width: 4, height: 3}}',
    'motion': '{setup_file: setup.yaml, detectors: [detector_a, detector_b], method: tracking_and_registration, '
              'gate: {max_age: 2, max_unverified_exposures: 40}, refinement: {mode: on_demand, every_n: 5}, '
              'consistency: {window: 10}, prediction: {latency: 0.1}, pose: {deadline: 0.2}}',
    'registration': '{setup_file: setup.yaml, source: ct, bodies: 1, mask: {from: bone, threshold_hu: 200}, '
                    'max_translation: 0.02, search: {max_rotation: 0.5}, time_budget: 2}',
    'simulator': '{setup_file: setup.yaml, source: phantom, rate: 15, seed: 3, image: {bits: 14, gain_drift: 0.02}, '
                 'motion: {type: breathing, amplitude_mm: [0, 2, 5.0], period: 4}}',
}
FRAMES = 'stamp_s,detector,file\n0.0,detector_a,a_0.png\n0.001,detector_b,b_0.png\n' \
         '1699999999.25,detector_a,a_1.png\n1699999999.25,detector_b,b_1.png\n'
POSES = '\ufeffstamp_s,tx_mm,ty_mm,tz_mm,qx,qy,qz,qw,note\r\n0.0,1.5,-2.0,3e0,0,0,0,1,\r\n' \
        '1699999999.25,1.5,-2.0,3,0.5,0.5,0.5,0.5,x\r\n'
RTK = '''<?xml version="1.0"?>
<!DOCTYPE RTKGEOMETRY>
<RTKThreeDCircularGeometry version="3">
  <SourceToIsocenterDistance>1000</SourceToIsocenterDistance>
  <SourceToDetectorDistance>1536</SourceToDetectorDistance>
  <Projection><GantryAngle>10</GantryAngle><ProjectionOffsetX>-1.5</ProjectionOffsetX></Projection>
  <Projection><GantryAngle>100</GantryAngle><ProjectionOffsetX>2</ProjectionOffsetX></Projection>
</RTKThreeDCircularGeometry>
'''


def exports():
    loader = importlib.machinery.SourceFileLoader('make_exports', os.path.join(HERE, '..', 'scripts', 'make_exports'))
    module = importlib.util.module_from_spec(importlib.util.spec_from_loader('make_exports', loader))
    loader.exec_module(module)
    return module


EXPORTS = exports()


class Corpus:
    def __init__(self, folder):
        self.folder = folder

    def path(self, reader, name):
        os.makedirs(os.path.join(self.folder, reader), exist_ok=True)
        return os.path.join(self.folder, reader, name)

    def write(self, reader, name, content):
        with open(self.path(reader, name), 'wb') as file:
            file.write(content if isinstance(content, bytes) else content.encode())


def views():
    return [EXPORTS.View(entry) for entry in EXPORTS.yaml.safe_load(DETECTORS)['detectors']]


def write_geometry(corpus):
    for view, folder in zip(views(), ('mayacam', '../companions')):
        EXPORTS.write_mayacam(view, corpus.path(folder, f'{view.name}.txt'))
    matrices = []
    for view in views():
        k, rotation, translation = view.camera()
        matrices.append(k @ numpy.column_stack((rotation, translation)))
    corpus.write('matrices', 'four_a_line.txt', '# two\n' + '\n'.join(
        ' '.join(repr(float(v)) for v in row) for matrix in matrices for row in matrix) + '\n')
    corpus.write('matrices', 'twelve_a_line.txt', '\n'.join(
        '[' + ', '.join(f'{v:.6g}' for v in matrix.ravel()) + ']' for matrix in matrices))
    corpus.write('rtk', 'two.xml', RTK)
    corpus.write('detectors', 'detectors.yaml', DETECTORS)
    corpus.write('detectors', 'distorted.yaml', DISTORTED)
    image = numpy.arange(48, dtype=numpy.uint16).reshape(6, 8) * 1000
    EXPORTS.write_rtimage(views()[0], image, 1, corpus.path('dicom_geometry', 'rtimage.dcm'))
    for angle, folder in ((100, 'dicom_geometry'), (30, '../companions')):
        data = EXPORTS.dataset('XA', pydicom.uid.XRayAngiographicImageStorage, 1)
        data.PositionerPrimaryAngle, data.PositionerSecondaryAngle = angle, -10
        data.DistanceSourceToDetector, data.DistanceSourceToPatient = 1200, 800
        data.ImagerPixelSpacing = [30, 30]
        EXPORTS.pixels(data, image)
        data.save_as(corpus.path(folder, 'xa.dcm'), write_like_original=False)


def write_images(corpus):
    image = numpy.arange(48, dtype=numpy.uint16).reshape(6, 8) * 1000
    PIL.Image.fromarray(image).save(corpus.path('png', 'mono16.png'))
    PIL.Image.fromarray((image // 256).astype(numpy.uint8)).save(corpus.path('png', 'mono8.png'))
    PIL.Image.fromarray(numpy.dstack([(image // 256).astype(numpy.uint8)] * 3)).save(corpus.path('png', 'grey_rgb.png'))
    PIL.Image.fromarray(image).save(corpus.path('tiff', 'mono16.tif'))
    PIL.Image.fromarray(image).save(corpus.path('tiff', 'lzw16.tif'), compression='tiff_lzw')
    PIL.Image.fromarray(image.astype(numpy.float32)).save(corpus.path('tiff', 'float.tif'))
    tiled = numpy.zeros((16, 16), '<u2')
    tiled[:6, :8] = image
    entries = [(256, 4, 1, 8), (257, 4, 1, 6), (258, 3, 1, 16), (259, 3, 1, 1), (262, 3, 1, 1), (277, 3, 1, 1),
               (322, 4, 1, 16), (323, 4, 1, 16), (324, 4, 1, 8), (325, 4, 1, 512)]
    corpus.write('tiff', 'tiled.tif', struct.pack('<2sHI', b'II', 42, 520) + tiled.tobytes()
                 + struct.pack('<H', len(entries)) + b''.join(struct.pack('<HHII', *entry) for entry in entries)
                 + struct.pack('<I', 0))
    packed = [(256, 4, 1, 8), (257, 4, 1, 6), (258, 3, 1, 12), (259, 3, 1, 1), (262, 3, 1, 1), (273, 4, 1, 8),
              (277, 3, 1, 1), (278, 4, 1, 6), (279, 4, 1, 72)]
    corpus.write('tiff', 'packed12.tif', struct.pack('>2sHI', b'MM', 42, 80) + bytes(range(72))
                 + struct.pack('>H', len(packed))
                 + b''.join(struct.pack('>HHI', *entry[:3])
                            + (struct.pack('>HH', entry[3], 0) if entry[1] == 3 else struct.pack('>I', entry[3]))
                            for entry in packed) + struct.pack('>I', 0))
    for name, syntax in (('plain', pydicom.uid.ExplicitVRLittleEndian), ('implicit', pydicom.uid.ImplicitVRLittleEndian),
                         ('rle', pydicom.uid.RLELossless)):
        data = EXPORTS.dataset('DX', pydicom.uid.DigitalXRayImageStorageForProcessing, 1)
        data.PixelIntensityRelationship, data.PixelIntensityRelationshipSign = 'LIN', 1
        data.RescaleIntercept, data.RescaleSlope = 0, 1
        EXPORTS.pixels(data, image)
        if name == 'rle':
            data.compress(syntax)
        data.file_meta.TransferSyntaxUID = syntax
        data.is_implicit_VR = name == 'implicit'
        data.save_as(corpus.path('dicom_image', f'{name}.dcm'), write_like_original=False)


def write_volumes(corpus):
    values = numpy.full((3, 5, 4), -1000, numpy.int16)
    values[:, 1:4, 1:3] = 40
    values[:, 2, 1:3] = 700
    spacing, origin = numpy.array([2.0, 2.0, 2.5]), numpy.array([-3.0, -4.0, -2.5])
    header = 'NRRD0004\ntype: int16\ndimension: 3\nspace: left-posterior-superior\nsizes: 4 5 3\n' \
             'space directions: (2,0,0) (0,2,0) (0,0,2.5)\nkinds: domain domain domain\nendian: little\n' \
             'encoding: {}\nspace origin: (-3,-4,-2.5)\n\n'
    corpus.write('nrrd', 'raw.nrrd', header.format('raw').encode() + values.tobytes())
    corpus.write('nrrd', 'text.nrrd', header.format('ascii') + ' '.join(str(v) for v in values.ravel()))
    corpus.write('nrrd', 'labels.nrrd', header.format('raw').encode() + (values > 0).astype(numpy.int16).tobytes())
    meta = 'ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\nCompressedData = {}\n' \
           'TransformMatrix = 1 0 0 0 1 0 0 0 1\nOffset = -3 -4 -2.5\nElementSpacing = 2 2 2.5\nDimSize = 4 5 3\n' \
           'AnatomicalOrientation = RAI\nElementType = MET_SHORT\n{}ElementDataFile = LOCAL\n'
    packed = zlib.compress(values.tobytes())
    corpus.write('meta', 'raw.mha', meta.format('False', '').encode() + values.tobytes())
    corpus.write('meta', 'packed.mha', meta.format('True', f'CompressedDataSize = {len(packed)}\n').encode() + packed)
    zipped = corpus.path('nifti', 'packed.nii.gz')
    EXPORTS.SHIFT = numpy.zeros(3)
    EXPORTS.write_nifti((values, spacing, origin), zipped)
    with EXPORTS.gzip.open(zipped) as file:
        corpus.write('nifti', 'plain.nii', file.read())
    EXPORTS.SLICES_MM = 2.5
    # The reader puts the outer ones beside what it is given for the middle one.
    with tempfile.TemporaryDirectory() as folder:
        EXPORTS.write_ct((values, spacing, origin), os.path.join(folder, 'ct'))
        for n, target in enumerate(('../companions', 'ct_slice', '../companions')):
            shutil.copy(os.path.join(folder, 'ct', f'IM{n:04}.dcm'), corpus.path(target, f'slice_{n}.dcm'))
    data = EXPORTS.dataset('CT', pydicom.uid.EnhancedCTImageStorage, 1)
    data.NumberOfFrames = 3
    shared = pydicom.Dataset()
    for name, content in (('PlaneOrientationSequence', {'ImageOrientationPatient': [1, 0, 0, 0, 1, 0]}),
                          ('PixelMeasuresSequence', {'PixelSpacing': [2, 2], 'SliceThickness': 2.5}),
                          ('PixelValueTransformationSequence', {'RescaleIntercept': 0, 'RescaleSlope': 1})):
        item = pydicom.Dataset()
        for key, value in content.items():
            setattr(item, key, value)
        setattr(shared, name, [item])
    data.SharedFunctionalGroupsSequence = [shared]
    frames = []
    for z in (-2.5, 0, 2.5):
        place, frame = pydicom.Dataset(), pydicom.Dataset()
        place.ImagePositionPatient = [-3, -4, z]
        frame.PlanePositionSequence = [place]
        frames.append(frame)
    data.PerFrameFunctionalGroupsSequence = frames
    EXPORTS.pixels(data, values[0])
    data.PixelData = values.tobytes()
    data.save_as(corpus.path('ct_file', 'enhanced.dcm'), write_like_original=False)


def write_plans(corpus):
    EXPORTS.SHIFT = numpy.zeros(3)
    EXPORTS.write_structures([numpy.full(3, -5.0), numpy.full(3, 5.0)], corpus.path('structure_set', 'block.dcm'))
    EXPORTS.write_plan(corpus.path('plan', 'one_beam.dcm'))


def text(words):
    """As the readers' Fields take one: its length in a byte, and its bytes."""
    return bytes([len(words)]) + words.encode()


def data(content):
    """As they take an image's: its length in two bytes, and its bytes."""
    return struct.pack('<H', len(content)) + content


def write_messages(corpus):
    corpus.write('image', 'mono16', struct.pack('<IIBI', 3, 4, 1, 8) + text('mono16') + data(bytes(range(24))))
    corpus.write('image', 'mono8', struct.pack('<IIBI', 3, 4, 0, 5) + text('mono8') + data(bytes(range(15))))
    with open(corpus.path('png', 'mono16.png'), 'rb') as file:
        compressed = text('16UC1; png compressed') + data(file.read())
    corpus.write('compressed_image', 'png', compressed)
    k, _, _ = views()[0].camera()
    info = struct.pack('<II', 6, 8) + k.astype('<f8').tobytes() + numpy.eye(3).tobytes() \
        + numpy.column_stack((k, numpy.zeros(3))).astype('<f8').tobytes() + struct.pack('<6I', 0, 0, 0, 0, 0, 0) \
        + text('plumb_bob') + bytes([5]) + bytes(40)
    corpus.write('camera_info', 'plain', info)
    write_recording(corpus, compressed, info)
    region = struct.pack('<4I', 1, 1, 4, 3)
    covariance = numpy.diag([0.01, 0.01, 1e-6, 1e-6, 1e-6, 1e-6])
    corpus.write('tracked_region', 'found', struct.pack('<BBII', 2, 3, 10, 0) + region + struct.pack('<2d', 0.5, -0.25)
                 + struct.pack('<4d', 1.0, -0.001, 0.001, 1.0) + covariance.tobytes() + text(''))
    corpus.write('refinement_request', 'near', struct.pack('<7d', 0, 0, 0, 0, 0, 0, 1) + struct.pack('<3d', 0, 0, 0)
                 + text('near') + bytes([2]) + region * 2)
    corpus.write('run_description', 'plain', json.dumps({
        'setup': DETECTORS + POSE + BOX, 'epoch_ns': 1699999999250000000, 'gold_standard': POSES,
        'versions': {'xray_tracking_tools': '1.0'}, 'parameters': {'/motion_estimation': {'rate': 15}}}))


def write_parameters(corpus):
    """As the parameter server sends them."""
    for node, text in PARAMETERS.items():
        answer = xmlrpc.client.dumps((EXPORTS.yaml.safe_load(text),))
        value = answer[answer.index('<value>'):answer.rindex('</value>') + len('</value>')]
        corpus.write(f'{node}_parameters', 'some', value)


def write_recording(corpus, compressed, info):
    """Two exposures as readRecording() puts them into a bag: the sequence's beginning; then each message's kind, stamp,
    time of recording and content."""
    image = struct.pack('<IIBI', 6, 8, 0, 16) + text('mono16') + data(bytes(range(1, 97)))
    pose = struct.pack('<7d', 0.0015, -0.002, 0.003, 0, 0, 0, 1)

    def message(kind, second, content):
        return struct.pack('<B4I', kind, 1700000000 + second, 0, 1700000000 + second, 1000) + content

    corpus.write('recording', 'two_exposures', struct.pack('<q', 1700000000 * 10 ** 9) + b''.join(
        message(4, n, info) + message(6, n, pose) + message(0, n, image) + message(3 if n else 1, n, compressed if n else image)
        + message(8 + n, n, text('xray_room') + text('detector_a') + pose) for n in range(2)))


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('folder', nargs='?', default=os.path.join(HERE, 'corpus'))
    corpus = Corpus(parser.parse_args().folder)
    for name, text in SEQUENCES.items():
        corpus.write('sequence', f'{name}.yaml', text)
    corpus.write('frames', 'frames.csv', FRAMES)
    corpus.write('poses', 'poses.csv', POSES)
    write_geometry(corpus)
    write_images(corpus)
    write_volumes(corpus)
    write_plans(corpus)
    write_messages(corpus)
    write_parameters(corpus)


if __name__ == '__main__':
    main()
