"""Faults of what the detectors send."""
import time

import numpy as np

from fault import CLOSES, CLOSES_ONCE, RIGHT, UNSEEN, fault


def rows_and_columns(rig, name, random, low, high):
    """A part of a detector's region: slices of rows and columns; the share of its height is between low and high."""
    (left, right), (top, bottom) = rig.setup.region(name)
    height = max(int((bottom - top) * random.uniform(low, high)), 1)
    first = int(random.integers(top, max(bottom - height, top) + 1))
    return slice(first, first + height), slice(left, right), height


def darker(rig, pixels, rows, columns, transmission):
    """What lets so much of the light through, in the way."""
    part = pixels[rows, columns].astype(float) - rig.setup.offset
    pixels[rows, columns] = np.clip(part * transmission + rig.setup.offset, 0, np.iinfo(pixels.dtype).max)


@fault("a detector stops", CLOSES)
def detector_stops(rig, random):
    name = rig.one_detector(random)
    return rig.alter_one(name, lambda one, k: setattr(one, "silent", True)), name


@fault("all detectors stop", CLOSES)
def all_detectors_stop(rig, random):
    return rig.alter_all(lambda one, k: setattr(one, "silent", True)), ""


def freeze(names):
    kept = {}

    def change(one, k):
        if one.detector in names:
            kept.setdefault(one.detector, one.pixels)
            one.pixels = kept[one.detector]
    return change


@fault("a detector sends the same image under new stamps", CLOSES)
def detector_freezes(rig, random):
    name = rig.one_detector(random)
    return rig.alter_all(freeze([name]), prepared=True), name


@fault("all detectors send the same images under new stamps", CLOSES)
def all_detectors_freeze(rig, random):
    return rig.alter_all(freeze(list(rig.setup.detectors)), prepared=True), ""


@fault("an image of one detector arrives late, with its stamp", RIGHT, seconds=(2.0, 4.0))
def detector_lags(rig, random):
    name, lag = rig.one_detector(random), random.uniform(0.05, 0.5)
    return rig.alter_one(name, lambda one, k: setattr(one, "delay", lag)), f"{name}, {1000 * lag:.0f} ms"


def lagging(rig, names, lag):
    """What was there `lag` seconds before, as if it were now."""
    behind = max(int(round(lag * rig.injector.rate)), 1)

    def change(one, k):
        if one.detector in names:
            one.pixels = rig.injector.pixels(one.detector, rig.injector.index(k - behind))
    return change, behind / rig.injector.rate


# Views that are of two moments contradict each other along the axis that both see, and along no other.
@fault("an image of one detector is late, under a new stamp", UNSEEN, seconds=(2.0, 4.0))
def detector_lags_restamped(rig, random):
    name = rig.one_detector(random)
    change, lag = lagging(rig, [name], random.uniform(0.05, 0.5))
    return rig.alter_all(change), f"{name}, {1000 * lag:.0f} ms"


@fault("all images are late, under new stamps", UNSEEN, seconds=(2.0, 4.0))
def all_lag_restamped(rig, random):
    change, lag = lagging(rig, list(rig.setup.detectors), random.uniform(0.05, 0.5))
    return rig.alter_all(change), f"{1000 * lag:.0f} ms"


@fault("a detector shows one moment again and again, with fresh noise", UNSEEN)
def detector_freezes_with_noise(rig, random):
    name, kept = rig.one_detector(random), {}

    def change(one, k):
        one.pixels = rig.injector.pixels(name, kept.setdefault("index", rig.injector.index(k)))
    return rig.alter_one(name, change), name


@fault("a detector sends garbage for pixels", CLOSES)
def garbage_pixels(rig, random):
    name = rig.one_detector(random)

    def change(one, k):
        one.pixels = random.integers(0, np.iinfo(one.pixels.dtype).max, one.pixels.shape, one.pixels.dtype, True)
    return rig.alter_one(name, change), name


LIES = {"data cut short": lambda image: setattr(image, "data", image.data[:len(image.data) // 3]),
        "no data": lambda image: setattr(image, "data", b""),
        "step of 0": lambda image: setattr(image, "step", 0),
        "4 billion columns": lambda image: setattr(image, "width", 0xFFFFFFFF),
        "4 billion rows and bytes a row": lambda image: (setattr(image, "height", 0xFFFFFFFF),
                                                         setattr(image, "step", 0xFFFFFFFF)),
        "no columns": lambda image: (setattr(image, "width", 0), setattr(image, "height", 0))}


@fault("a detector's images contradict themselves: size and data", CLOSES)
def garbage_message(rig, random):
    name, lie = rig.one_detector(random), str(random.choice(list(LIES)))
    return rig.alter_one(name, lambda one, k: setattr(one, "edit", LIES[lie])), f"{name}, {lie}"


@fault("the images' size changes", CLOSES)
def size_changes(rig, random):
    name, step = rig.one_detector(random), int(random.integers(2, 5))

    def change(one, k):
        one.pixels = np.ascontiguousarray(one.pixels[::step, ::step])
    return rig.alter_one(name, change), f"{name}, to one {step}th"


@fault("the images' encoding changes", CLOSES)
def encoding_changes(rig, random):
    name, encoding = rig.one_detector(random), str(random.choice(["rgb8", "32FC1", "bayer_rggb16", "", "mono17"]))
    return rig.alter_one(name, lambda one, k: setattr(one, "encoding", encoding)), f'{name}, to "{encoding}"'


@fault("a detector is saturated as a whole", CLOSES)
def saturates(rig, random):
    name = rig.one_detector(random)
    return rig.alter_one(name, lambda one, k: one.pixels.fill(np.iinfo(one.pixels.dtype).max)), name


@fault("the dose rises until parts are saturated", RIGHT)
def saturates_in_part(rig, random):
    name, gain = rig.one_detector(random), random.uniform(1.5, 8.0)

    def change(one, k):
        one.pixels = np.clip(one.pixels * gain, 0, np.iinfo(one.pixels.dtype).max).astype(one.pixels.dtype)
    return rig.alter_one(name, change), f"{name}, {gain:.1f} times"


@fault("rows of the region are dead", RIGHT)
def dead_rows(rig, random):
    name = rig.one_detector(random)
    rows, columns, height = rows_and_columns(rig, name, random, 0.01, 0.3)
    return rig.alter_one(name, lambda one, k: one.pixels[rows].fill(0)), f"{name}, {height} rows"


@fault("blades close over a part of the region", RIGHT)
def collimated(rig, random):
    name, share = rig.one_detector(random), random.uniform(0.1, 0.7)
    (left, right), _ = rig.setup.region(name)
    edge = left + int((right - left) * share)
    return (rig.alter_one(name, lambda one, k: darker(rig, one.pixels, slice(None), slice(0, edge), 0.02)),
            f"{name}, {100 * share:.0f} % of it")


@fault("metal passes through the region of one view", RIGHT, seconds=(1.0, 3.0))
def metal_passes(rig, random):
    name, began = rig.one_detector(random), time.monotonic()
    (left, right), _ = rig.setup.region(name)
    width, transmission = int(random.integers(5, 50)), random.uniform(0.005, 0.3)
    speed = (right - left) / random.uniform(0.8, 2.5)

    def change(one, k):
        at = int(left + speed * (time.monotonic() - began))
        darker(rig, one.pixels, slice(None), slice(at, at + width), transmission)
    return rig.alter_one(name, change), f"{name}, {width} px, lets {100 * transmission:.1f} % through"


@fault("a cough: 12 mm in one exposure, and back", CLOSES_ONCE, seconds=(0.5, 1.0))
def cough(rig, random):
    first = []

    def show(k):
        index = rig.injector.bank.index(k, rig.injector.rate)
        first.append(k)
        return rig.injector.bank.cough(index) if k == first[0] else index
    return rig.show(show), ""


@fault("the images of two detectors are exchanged", CLOSES)
def images_swapped(rig, random):
    a, b = sorted(rig.setup.detectors)

    def alter(sent, k):
        sent[a].pixels, sent[b].pixels = sent[b].pixels, sent[a].pixels
    return rig.altering(alter), ""
