"""The faults: what is done to the graph, and what must come of it."""
import dataclasses
import os
import signal
import subprocess
import sys
import time
from typing import Callable

import numpy as np
import rospy
from xray_tracking_msgs.srv import LoadVolume

from graph import signal_node

# What must come of a fault.
CLOSES = "the gate closes and stays closed"
CLOSES_ONCE = "the gate closes"
RIGHT = "the gate may stay open; every pose under an open gate is right"
NEVER_OPENS = "the gate never opens"
UNSEEN = "cannot be seen by principle; how wrong it gets is measured"

ITSELF = "by itself"
RESTART = "the graph is started again"


@dataclasses.dataclass
class Fault:
    """`inject(rig, random)` begins it. @return (how to end it, or None; its strength in words)"""
    name: str
    words: str
    must: str
    inject: Callable
    seconds: tuple = (1.0, 3.0)  # how long it lasts
    recovery: str = ITSELF
    recovery_s: float = 15.0     # by then the gate is open again
    graph: str = "plain"         # plain; interposed, sim_time, record: see campaign.launch; started: before the graph is
    dies: tuple = ()             # nodes that it ends


FAULTS = {}


def fault(words, must, **options):
    def add(inject):
        FAULTS[inject.__name__] = Fault(inject.__name__, words, must, inject, **options)
        return inject
    return add


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


# Images ---------------------------------------------------------------------------------------------------------------

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


@fault("an image of one detector is late, under a new stamp", RIGHT, seconds=(2.0, 4.0))
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


# Geometry and time ----------------------------------------------------------------------------------------------------

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


@fault("the clock (/clock) jumps back", CLOSES_ONCE, graph="sim_time")
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


# Processes ------------------------------------------------------------------------------------------------------------

def killed(rig, node):
    signal_node(rig.pids[node], signal.SIGKILL)
    return None, "SIGKILL"


def stopped(rig, node):
    pid = rig.pids[node]
    signal_node(pid, signal.SIGSTOP)
    return lambda: signal_node(pid, signal.SIGCONT), "SIGSTOP"


@fault("the registration dies", RIGHT, dies=("registration",), recovery="respawn", recovery_s=40.0)
def registration_killed(rig, random):
    return killed(rig, "registration")


@fault("the registration hangs", RIGHT, seconds=(1.0, 8.0))
def registration_hangs(rig, random):
    return stopped(rig, "registration")


@fault("the process that watches over a tracker dies", RIGHT, seconds=(8.0, 9.0), recovery="respawn",
       dies=("detector_a_hyperplane_tracker",), recovery_s=30.0)
def tracker_loader_killed(rig, random):
    return killed(rig, "detector_a_hyperplane_tracker")


@fault("all trackers' process dies", CLOSES, recovery=RESTART, dies=("xray_nodelets",))
def trackers_killed(rig, random):
    return killed(rig, "xray_nodelets")


@fault("all trackers' process hangs", CLOSES)
def trackers_hang(rig, random):
    return stopped(rig, "xray_nodelets")


@fault("motion estimation dies", CLOSES, recovery=RESTART, dies=("motion_estimation",))
def motion_estimation_killed(rig, random):
    return killed(rig, "motion_estimation")


@fault("motion estimation hangs", CLOSES)
def motion_estimation_hangs(rig, random):
    return stopped(rig, "motion_estimation")


@fault("the room's publisher dies", RIGHT, recovery="respawn", dies=("treatment_room_publisher",))
def room_publisher_killed(rig, random):
    return killed(rig, "treatment_room_publisher")


@fault("the master dies and comes back", RIGHT, seconds=(3.0, 5.0), recovery="goes on without; names are lost, so that "
       "nothing can be started beside it")
def master_dies(rig, random):
    rig.master.kill()
    return rig.master.start, "SIGKILL"


@fault("memory runs out for the registration", RIGHT, seconds=(3.0, 6.0), recovery_s=40.0)
def memory_limit(rig, random):
    pid = rig.pids["registration"]
    with open(f"/proc/{pid}/statm", encoding="ascii") as file:
        used = int(file.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    spare = int(random.uniform(0.0, 60e6))
    subprocess.run(["prlimit", "--pid", str(pid), f"--as={used + spare}:unlimited"], check=True)
    return (lambda: subprocess.run(["prlimit", "--pid", str(pid), "--as=unlimited:unlimited"], check=False),
            f"{spare / 1e6:.0f} MB more than it has")


@fault("other processes take all of the processor", RIGHT, seconds=(3.0, 6.0))
def processor_busy(rig, random):
    count = 2 * len(os.sched_getaffinity(0))
    burners = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]

    def end():
        for burner in burners:
            burner.kill()
            burner.wait()
    return end, f"{count} processes"


@fault("the disk is full while it records", RIGHT, graph="record")
def disk_full(rig, random):
    subprocess.run(["prlimit", "--pid", str(rig.pids["recorder"]), "--fsize=1000000"], check=True)
    return None, "no file of the recorder may grow"


# What the registration says -------------------------------------------------------------------------------------------

@fault("the registration answers late", RIGHT, graph="interposed", seconds=(2.0, 6.0))
def registration_late(rig, random):
    delay = random.uniform(0.05, 2.5)
    return rig.alter_answers(lambda result: time.sleep(delay)), f"{1000 * delay:.0f} ms"


def shifted(rig, random, mm, times=None):
    direction = random.normal(size=3)
    direction *= mm / 1000.0 / np.linalg.norm(direction)
    asked = []

    def change(result):
        asked.append(result)
        if (times is None or len(asked) <= times) and result.status == result.SUCCESS:
            position = result.pose.pose.position
            position.x, position.y, position.z = np.add((position.x, position.y, position.z), direction)
    return rig.alter_answers(change), f"along {np.round(1000 * direction, 1).tolist()}"


@fault("one answer of the registration is wrong by 3 mm, with SUCCESS", RIGHT, graph="interposed")
def registration_wrong_by_3_mm_once(rig, random):
    return shifted(rig, random, 3.0, 1)


@fault("all answers of the registration are wrong by 3 mm, with SUCCESS", UNSEEN, graph="interposed", seconds=(2.0, 5.0))
def registration_wrong_by_3_mm(rig, random):
    return shifted(rig, random, 3.0)


@fault("all answers of the registration are wrong by 20 mm, with SUCCESS", CLOSES, graph="interposed",
       seconds=(2.0, 5.0))
def registration_wrong_by_20_mm(rig, random):
    return shifted(rig, random, 20.0)


def no_numbers(result):
    result.pose.pose.position.x = float("nan")


def no_rotation(result):
    result.pose.pose.orientation.w += 0.5


def no_covariance(result):
    result.pose.covariance = [-1.0] * 36


@fault("the registration's answers are garbage, with SUCCESS", RIGHT, graph="interposed", seconds=(2.0, 5.0))
def registration_garbage(rig, random):
    change = [no_numbers, no_rotation, no_covariance][random.integers(3)]
    return rig.alter_answers(change), change.__name__.replace("_", " ")


@fault("another patient's CT is loaded", RIGHT, seconds=(4.0, 6.0), dies=("registration",), recovery_s=40.0,
       recovery="the right CT is loaded again (here: respawn)")
def another_ct(rig, random):
    answer = rospy.ServiceProxy("/registration/load_volume", LoadVolume)(rig.other_ct)
    if not answer.success:
        raise RuntimeError(f"load_volume: {answer.message}")
    return lambda: killed(rig, "registration"), os.path.basename(rig.other_ct)
