"""Faults of geometry and time."""
import os

import numpy as np

from fault import CLOSES, CLOSES_ONCE, NEVER_OPENS, UNSEEN, fault
from image_faults import images_swapped


def info_with(one, **fields):
    changed = type(one.info)(**{slot: getattr(one.info, slot) for slot in one.info.__slots__})
    for key, value in fields.items():
        setattr(changed, key, value)
    one.info = changed


@fault("camera_info says that a panel is 1 mm elsewhere from now on", CLOSES)
def camera_info_changes(rig, random):
    name = rig.one_detector(random)

    def change(one, k):
        K, P = list(one.info.K), list(one.info.P)
        K[2] += 1.0 / rig.setup.detectors[name].pitch[0]
        P[2] = K[2]
        info_with(one, K=K, P=P)
    return rig.alter_one(name, change), name


@fault("camera_info is garbage: no numbers, no focal length, a lens", CLOSES)
def camera_info_garbage(rig, random):
    name = rig.one_detector(random)
    fields = [dict(K=[float("nan")] * 9), dict(K=[0.0] * 9, P=[0.0] * 12), dict(D=[0.3, 0.0, 0.0, 0.0, 0.0]),
              dict(width=0, height=0)][random.integers(4)]
    return rig.alter_one(name, lambda one, k: info_with(one, **fields)), f"{name}, {', '.join(fields)}"


def another_place(rig, name, **move):
    frame = rig.setup.detectors[name].camera_info().header.frame_id
    before = rig.transforms.of(frame)
    rig.transforms.say(rig.transforms.moved(before, **move))
    return lambda: rig.transforms.say(before)


@fault("tf of a detector jumps by 1 to 20 mm", CLOSES)
def tf_jumps(rig, random):
    name, shift = rig.one_detector(random), random.uniform(-0.02, 0.02, 3)
    shift = shift / np.linalg.norm(shift) * random.uniform(0.001, 0.02)
    return another_place(rig, name, shift_m=shift), f"{name}, {1000 * np.linalg.norm(shift):.1f} mm"


@fault("tf of a detector turns by 0.5 degrees", CLOSES)
def tf_turns(rig, random):
    name, axis = rig.one_detector(random), int(random.integers(3))
    quaternion = [0.0, 0.0, 0.0, np.cos(np.radians(0.25))]
    quaternion[axis] = np.sin(np.radians(0.25))
    return another_place(rig, name, quaternion=quaternion), f"{name} about {'xyz'[axis]}"


@fault("stamps are 10 years ahead", CLOSES)
def stamps_of_the_future(rig, random):
    names = list(rig.setup.detectors) if random.random() < 0.5 else [rig.one_detector(random)]
    return (rig.alter_all(lambda one, k: one.detector in names and
                          setattr(one, "stamp", one.stamp + 10 * 365.25 * 86400)), ", ".join(names))


@fault("stamps are some seconds back", CLOSES)
def stamps_of_the_past(rig, random):
    back = random.uniform(1.5, 100.0)
    return rig.alter_all(lambda one, k: setattr(one, "stamp", one.stamp - back)), f"{back:.1f} s"


@fault("all exposures have the same stamp", CLOSES)
def stamps_repeat(rig, random):
    kept = []

    def change(one, k):
        kept.append(one.stamp)
        one.stamp = kept[0]
    return rig.alter_all(change, prepared=True), ""


def clock_jump(rig, seconds):
    rig.clock.jump += seconds
    return None, f"{seconds:+.1f} s"


@fault("the clock (/clock) jumps forward", CLOSES_ONCE, graph="sim_time")
def clock_jumps_forward(rig, random):
    return clock_jump(rig, 10 ** random.uniform(0.3, 3.5))


@fault("the clock (/clock) jumps back", CLOSES_ONCE, graph="sim_time", begins_anew=True)
def clock_jumps_back(rig, random):
    return clock_jump(rig, -10 ** random.uniform(0.3, 2.0))


@fault("the clock (/clock) stands still", CLOSES, graph="sim_time")
def clock_stops(rig, random):
    # As an exposure is made: the next one is the first whose stamp is not its time.
    end_altering = rig.alter_all(lambda one, k: rig.clock.stop(one.stamp), prepared=True)

    def end():
        end_altering()
        rig.clock.go_on()
    return end, ""


def miscalibrated(rig, random, **wrong):
    name = rig.one_detector(random)
    path = os.path.join(rig.folder, "miscalibrated.yaml")
    rig.setup.write_miscalibrated(path, name, **wrong)
    rig.use_setup(path)
    return None, name


@fault("a panel stands 1 mm from where the setup has it, from the start", UNSEEN, graph="started", seconds=(6.0, 8.0))
def panel_wrong_by_1_mm(rig, random):
    return miscalibrated(rig, random, shift_mm=float(random.choice([-1, 1])))


@fault("a detector is turned by 0.5 degrees from how the setup has it, from the start", UNSEEN, graph="started",
       seconds=(6.0, 8.0))
def detector_wrong_by_half_a_degree(rig, random):
    return miscalibrated(rig, random, turn_degrees=float(random.choice([-0.5, 0.5])))


@fault("the images of two detectors are exchanged, from the start", NEVER_OPENS, graph="started", seconds=(6.0, 8.0))
def images_swapped_from_the_start(rig, random):
    return images_swapped(rig, random)
