#!/usr/bin/python3
"""Installs the built workspace into a folder of its own and works from there, with an environment that knows nothing of the
workspace: programs, launch files, nodelets, RViz's plugins and the report; and nobody but this computer is listened to."""
import glob
import os
import re
import shutil
import subprocess
import tempfile
import threading
import unittest

import rospkg
import rostest

DEVEL = os.environ["CMAKE_PREFIX_PATH"].split(":")[0]
BUILD = os.path.join(os.path.dirname(DEVEL), "build")
# Of the build alone.
NOT_INSTALLED = re.compile(r"_test$|^cmake\.lock$")


def listening_addresses(marker):
    """{(process, its name): local addresses on which it listens}, of those that have the marker in their environment."""
    sockets = {}
    for name in ("tcp", "tcp6"):
        with open(f"/proc/net/{name}", encoding="ascii") as file:
            for line in file.readlines()[1:]:
                fields = line.split()
                if fields[3] == "0A":
                    sockets[fields[9]] = fields[1].rsplit(":", 1)[0]
    found = {}
    for process in glob.glob("/proc/[0-9]*"):
        try:
            with open(process + "/environ", "rb") as file:
                if marker.encode() not in file.read():
                    continue
            with open(process + "/comm", encoding="utf-8") as file:
                name = file.read().strip()
            addresses = found.setdefault((process, name), [])
            for link in glob.glob(process + "/fd/*"):
                inode = re.fullmatch(r"socket:\[(\d+)\]", os.readlink(link))
                if inode and inode.group(1) in sockets:
                    addresses.append(sockets[inode.group(1)])
        except OSError:  # it has ended, or is another user's
            pass
    return found


class InstallTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.mkdtemp(prefix="xray_tracking_install_")
        # catkin writes its setup files where the build was told to install, whatever --prefix says.
        with open(os.path.join(BUILD, "CMakeCache.txt"), encoding="utf-8") as file:
            cls.prefix = cls.folder + re.search(r"^CMAKE_INSTALL_PREFIX:PATH=(.*)$", file.read(), re.MULTILINE).group(1)
        subprocess.run(["cmake", "--install", BUILD], check=True, stdout=subprocess.PIPE,
                       env={"PATH": "/usr/bin:/bin", "DESTDIR": cls.folder})

    @classmethod
    def tearDownClass(cls):
        shutil.rmtree(cls.folder)

    def command(self, text):
        """As a user would type it in a new terminal."""
        environment = {"PATH": "/usr/bin:/bin", "HOME": self.folder, "ROS_HOME": os.path.join(self.folder, "ros"),
                       "ROS_LOG_DIR": os.path.join(self.folder, "log")}
        return subprocess.Popen(["bash", "-c", f". {self.prefix}/setup.bash && {text}"], cwd=self.folder, env=environment,
                                stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)

    def run_command(self, text, status=0):
        with self.command(text) as process:
            said = process.communicate(timeout=100)[0]
        self.assertEqual(process.returncode, status, said)
        return said

    def test_everything_is_found_where_it_was_installed(self):
        packages = sorted(name for name in rospkg.RosPack().list() if name.startswith("xray_tracking"))
        self.assertEqual(len(packages), 10)  # and the metapackage, which rospack does not count
        self.assertTrue(os.path.exists(os.path.join(self.prefix, "share", "xray_tracking", "package.xml")))
        for line in self.run_command(f"for p in {' '.join(packages)}; do rospack find $p; done").splitlines():
            self.assertTrue(line.startswith(self.prefix), line)
        for export in ("nodelet", "rviz"):
            for line in self.run_command(f"rospack plugins --attrib=plugin {export}").splitlines():
                if line.startswith("xray_tracking"):
                    path = line.split(maxsplit=1)[1]
                    self.assertTrue(path.startswith(self.prefix) and os.path.exists(path), line)
        for package in packages:
            built = {name for name in os.listdir(os.path.join(DEVEL, "lib", package)) if not NOT_INSTALLED.search(name)} \
                if os.path.isdir(os.path.join(DEVEL, "lib", package)) else set()
            installed = os.path.join(self.prefix, "lib", package)
            self.assertEqual(built - set(os.listdir(installed) if os.path.isdir(installed) else []), set(), package)

    def test_programs_load_their_libraries(self):
        tools = os.path.join(self.prefix, "lib", "xray_tracking_tools")
        said = self.run_command("for f in $(find " + self.prefix + "/lib -type f -name '*.so' -o -type f -path '*/lib/xray_*'"
                                " -perm -u+x); do case $(head -c 4 $f | tail -c 3) in ELF) ldd $f;; esac; done")
        for line in said.splitlines():
            self.assertNotIn("not found", line)
            self.assertNotIn(DEVEL, line)
        for name in ("check_bag", "evaluate_bag", "evaluate_sequence", "import_geometry", "make_sequences",
                     "setup_from_plan", "show_setup", "make_exports", "write_report", "write_cohort_report"):
            self.assertIn(name, os.listdir(tools))
            self.assertIn("usage", self.run_command(f"rosrun xray_tracking_tools {name} --help").lower(), name)

    def test_the_treatment_room_runs(self):
        with_display = os.path.join(rospkg.RosPack().get_path("xray_tracking_rviz_plugins"), "test", "with_display")
        recording = os.path.join(self.folder, "recorded.bag")
        heard = []
        with self.command(f"sh {with_display} roslaunch -p 24597 xray_tracking_bringup treatment_room.launch exposures:=12 "
                          f"supervised:=true initial_pose_verified:=true record:={recording}") as graph:
            ended = threading.Event()

            def listen():
                while not ended.wait(0.5):
                    heard.extend(listening_addresses(f"ROS_LOG_DIR={self.folder}/log").items())

            listener = threading.Thread(target=listen)
            listener.start()
            said = graph.communicate(timeout=100)[0]
            ended.set()
            listener.join()
        self.assertEqual(graph.returncode, 0, said)
        for words in ("could not be loaded", "Failed to load", "PluginlibFactory", "not find"):
            self.assertNotIn(words, said)
        names = {name for (_, name), addresses in heard if addresses}
        for name in ("rosmaster", "roslaunch", "nodelet", "rviz", "motion_estimati"):
            self.assertIn(name, names)
        for (_, name), addresses in heard:
            # 127.0.0.1, as the kernel writes it. Of roscpp's two sockets that of its XML-RPC is on all interfaces whatever
            # is set (docs/security.md); that of topics and services is not.
            elsewhere = [address for address in addresses if address != "0100007F"]
            self.assertLessEqual(len(elsewhere), 0 if name in ("rosmaster", "roslaunch") else 1, (name, addresses))
        out = os.path.join(self.folder, "out")
        tables = self.run_command(f"rosrun xray_tracking_tools evaluate_bag {recording} {out} && "
                                  f"rosrun xray_tracking_tools write_report {out}")
        self.assertTrue(os.path.exists(os.path.join(out, "report.html")), tables)


if __name__ == "__main__":
    rostest.rosrun("xray_tracking_bringup", "install", InstallTest)
