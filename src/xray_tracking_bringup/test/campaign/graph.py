"""The graph's processes: a master and a roslaunch of one's own, who is alive, and who has died."""
import os
import re
import signal
import socket
import subprocess
import time
import xmlrpc.client

import rosgraph

PACKAGE_LAUNCH = os.path.join(os.path.dirname(os.path.abspath(__file__)), "campaign.launch")
# All are started again by the launch files.
NODES = ("registration", "motion_estimation", "xray_nodelets", "treatment_room_publisher")
DIED = re.compile(r"process has (?:died|finished)|REQUIRED process|Segmentation|terminate called")


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class TimedTransport(xmlrpc.client.Transport):
    def make_connection(self, host):
        connection = super().make_connection(host)
        connection.timeout = 3.0
        return connection


class Master:
    def __init__(self, log_folder):
        self.port, self.log_folder = free_port(), log_folder
        self.process = None
        os.environ.update(ROS_MASTER_URI=f"http://127.0.0.1:{self.port}", ROS_HOSTNAME="127.0.0.1")
        os.environ.pop("ROS_IP", None)
        self.start()

    def start(self):
        with open(os.path.join(self.log_folder, "master.log"), "a", encoding="utf-8") as log:
            self.process = subprocess.Popen(["rosmaster", "--core", "-p", str(self.port)], stdout=log, stderr=log)
        end = time.monotonic() + 30.0
        while time.monotonic() < end:
            try:
                rosgraph.Master("/campaign").getPid()
                return
            except OSError:
                time.sleep(0.1)
        self.kill()
        raise TimeoutError("the master does not come up within 30 s")

    def kill(self):
        self.process.kill()
        self.process.wait()


class Graph:
    def __init__(self, log_folder, arguments):
        self.log_path = os.path.join(log_folder, "roslaunch.log")
        with open(self.log_path, "w", encoding="utf-8") as log:
            self.process = subprocess.Popen(
                ["roslaunch", PACKAGE_LAUNCH] + [f"{key}:={value}" for key, value in arguments.items()],
                stdout=log, stderr=subprocess.STDOUT, env=dict(os.environ, ROS_LOG_DIR=log_folder))

    def pid(self, node):
        """Of a node that answers; None of one that is not there or says nothing."""
        try:
            uri = rosgraph.Master("/campaign").lookupNode("/" + node)
            return xmlrpc.client.ServerProxy(uri, transport=TimedTransport()).getPid("/campaign")[2]
        except (rosgraph.MasterException, OSError, xmlrpc.client.Error):
            return None

    def pids(self, nodes=NODES):
        return {node: self.pid(node) for node in nodes}

    def wait_for(self, nodes, timeout):
        """@return their process ids"""
        end, pids = time.monotonic() + timeout, {}
        while time.monotonic() < end:
            pids = self.pids(nodes)
            if all(pids.values()):
                return pids
            time.sleep(0.3)
        raise TimeoutError(f"no answer within {timeout} s from {[node for node, pid in pids.items() if not pid]}")

    def log_size(self):
        return os.path.getsize(self.log_path)

    def deaths(self, since):
        """Lines of roslaunch's output behind a byte that tell of a process's end."""
        with open(self.log_path, encoding="utf-8", errors="replace") as file:
            file.seek(since)
            return [line.strip() for line in file if DIED.search(line)]

    def stop(self):
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
            try:
                self.process.wait(30)
            except subprocess.TimeoutExpired:
                self.process.terminate()
                self.process.wait(30)


def signal_node(pid, number):
    try:
        os.kill(pid, number)
    except ProcessLookupError:
        pass
