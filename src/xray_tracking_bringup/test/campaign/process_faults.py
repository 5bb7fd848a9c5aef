"""Faults of processes, and what the registration says."""
import os
import signal
import subprocess
import sys
import time

import numpy as np
import rospy
from xray_tracking_msgs.srv import LoadVolume

from fault import CLOSES, CLOSES_ONCE, RIGHT, UNSEEN, fault
from graph import signal_node


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


@fault("all trackers' process dies", CLOSES_ONCE, recovery="respawn", recovery_s=40.0, dies=("xray_nodelets",))
def trackers_killed(rig, random):
    return killed(rig, "xray_nodelets")


@fault("all trackers' process dies, and soon again", CLOSES_ONCE, seconds=(1.0, 5.0), recovery="respawn",
       recovery_s=40.0, dies=("xray_nodelets",))
def trackers_killed_twice(rig, random):
    killed(rig, "xray_nodelets")

    def end():
        again = None
        while again in (None, rig.pids["xray_nodelets"]):  # roslaunch starts it after a second
            again = rig.graph.pid("xray_nodelets")
        signal_node(again, signal.SIGKILL)
    return end, "SIGKILL"


@fault("all trackers' process hangs", CLOSES)
def trackers_hang(rig, random):
    return stopped(rig, "xray_nodelets")


@fault("motion estimation dies", CLOSES_ONCE, recovery="respawn", recovery_s=40.0, dies=("motion_estimation",))
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
       recovery="the right CT is loaded again (here: by a first node of this name)")
def another_ct(rig, random):
    answer = rospy.ServiceProxy("/registration/load_volume", LoadVolume)(rig.other_ct)
    if not answer.success:
        raise RuntimeError(f"load_volume: {answer.message}")

    def load_the_setups():
        rospy.delete_param("/registration/restart_token")
        killed(rig, "registration")

    return load_the_setups, os.path.basename(rig.other_ct)
