"""Plays exposures to the graph, in the detectors' place, and lets faults alter them on their way."""
import threading
import time

import numpy as np
import rospy
import tf2_ros
from geometry_msgs.msg import TransformStamped
from rosgraph_msgs.msg import Clock as ClockMessage
from sensor_msgs.msg import CameraInfo, Image
from tf2_msgs.msg import TFMessage
from xray_tracking_msgs.srv import RefinePose

NOISES = 8
SIM_START = 1000.0  # [s]
CLOCK_PERIOD = 0.01  # [s]


class Clock:
    """The clock that stamps are of: the computer's, or with /clock one that faults may set."""

    def __init__(self, sim_time):
        self.sim_time = sim_time
        self.jump = 0.0  # [s]
        self.stopped = None
        self.began = time.monotonic()
        if sim_time:
            self.publisher = rospy.Publisher("/clock", ClockMessage, queue_size=1)
            threading.Thread(target=self.run, daemon=True).start()

    def now(self):
        """[s]"""
        if not self.sim_time:
            return time.time()
        return self.stopped if self.stopped is not None else SIM_START + time.monotonic() - self.began + self.jump

    def stop(self, at):
        self.stopped = self.stopped or at

    def go_on(self):
        self.stopped = None

    def run(self):
        while not rospy.is_shutdown():
            self.publisher.publish(ClockMessage(rospy.Time.from_sec(self.now())))
            time.sleep(CLOCK_PERIOD)


class Sent:
    """What is about to be sent of one detector: faults change its fields. `pixels` is its own copy."""

    def __init__(self, detector, stamp, pixels, info):
        self.detector, self.stamp, self.pixels, self.info = detector, stamp, pixels, info
        self.encoding = "mono8" if pixels.dtype == np.uint8 else "mono16"
        self.delay = 0.0           # [s]
        self.silent = False
        self.edit = lambda image: None  # of the message

    def messages(self):
        stamp = rospy.Time.from_sec(max(self.stamp, 1e-3))
        image = Image(height=self.pixels.shape[0], width=self.pixels.shape[1], encoding=self.encoding,
                      step=self.pixels.strides[0], data=self.pixels.tobytes())
        image.header.stamp, image.header.frame_id = stamp, self.info.header.frame_id
        self.edit(image)
        info = CameraInfo(**{slot: getattr(self.info, slot) for slot in self.info.__slots__})
        info.header = image.header
        return image, info


class Injector:
    """Exposures at a steady rate. `alter(sent, k)`, if there is one, is given a dictionary detector -> Sent."""

    def __init__(self, bank, setup, rate, clock, seed):
        self.bank, self.setup, self.rate, self.clock = bank, setup, rate, clock
        self.alter = None
        self.show = None           # k -> index in the bank, in the place of the breath
        self.truth = {}            # stamp [ns] -> 4 x 4
        self.sent_at = {}          # stamp [ns] -> monotonic time
        self.k = 0
        self.late = 0              # exposures that this process itself could not send in time
        random = np.random.default_rng(seed)
        self.random = random
        sigma = 0.6 if next(iter(bank.images.values())).dtype == np.uint8 else 60.0
        shape = next(iter(bank.images.values())).shape[1:]
        self.noises = [np.round(random.normal(0.0, sigma, shape)).astype(np.int32) for _ in range(NOISES)]
        self.infos = {name: detector.camera_info() for name, detector in setup.detectors.items()}
        self.publishers = {name: (rospy.Publisher(f"/{name}/image_raw", Image, queue_size=10, tcp_nodelay=True),
                                  rospy.Publisher(f"/{name}/camera_info", CameraInfo, queue_size=10, tcp_nodelay=True))
                           for name in setup.detectors}
        self.running = True
        self.thread = threading.Thread(target=self.run, daemon=True)

    def start(self):
        self.thread.start()

    def stop(self):
        self.running = False
        if self.thread.is_alive():
            self.thread.join(5.0)

    def unconnected(self, subscribers):
        """Topics of images and camera_info that fewer nodes listen to, and how many do."""
        counts = {publisher.resolved_name: publisher.get_num_connections()
                  for pair in self.publishers.values() for publisher in pair}
        return {topic: count for topic, count in counts.items() if count < subscribers}

    def index(self, k):
        return self.show(k) if self.show else self.bank.index(k, self.rate)

    def pixels(self, detector, index):
        """Of an exposure of the bank with fresh noise: no two exposures are alike, whatever is repeated."""
        noise = np.roll(self.noises[self.random.integers(NOISES)], int(self.random.integers(1 << 18)))
        image = self.bank.images[detector][index]
        return np.clip(image + noise, 0, np.iinfo(image.dtype).max).astype(image.dtype)

    def run(self):
        begin = time.monotonic()
        while self.running:
            index = self.index(self.k)
            images = {name: self.pixels(name, index) for name in self.setup.detectors}
            due = begin + self.k / self.rate
            wait = due - time.monotonic()
            if wait > 0:
                time.sleep(wait)
            elif wait < -1.0 / self.rate:
                self.late += 1
            stamp = self.clock.now()
            sent = {name: Sent(name, stamp, pixels, self.infos[name]) for name, pixels in images.items()}
            key = rospy.Time.from_sec(stamp).to_nsec()
            self.truth[key], self.sent_at[key] = self.bank.truth[index], time.monotonic()
            if self.alter:
                self.alter(sent, self.k)
            for one in sent.values():
                if one.silent:
                    continue
                messages = one.messages()
                if one.delay > 0:
                    threading.Timer(one.delay, self.publish, (one.detector, messages)).start()
                else:
                    self.publish(one.detector, messages)
            self.k += 1

    def publish(self, detector, messages):
        for publisher, message in zip(self.publishers[detector], messages):
            publisher.publish(message)


class StaticTransforms:
    """Says that a detector stands elsewhere, as a second publisher of /tf_static."""

    def __init__(self):
        self.publisher = rospy.Publisher("/tf_static", TFMessage, queue_size=1, latch=True)
        self.buffer = tf2_ros.Buffer()
        self.listener = tf2_ros.TransformListener(self.buffer)

    def of(self, frame):
        return self.buffer.lookup_transform("treatment_room", frame, rospy.Time(0), rospy.Duration(5.0))

    def say(self, transform):
        self.publisher.publish(TFMessage([transform]))

    @staticmethod
    def moved(transform, shift_m=(0, 0, 0), quaternion=None):
        result = TransformStamped(header=transform.header, child_frame_id=transform.child_frame_id)
        t, q = transform.transform.translation, transform.transform.rotation
        for axis, shift in zip("xyz", shift_m):
            setattr(result.transform.translation, axis, getattr(t, axis) + shift)
        for axis in "xyzw":
            setattr(result.transform.rotation, axis, getattr(q, axis))
        if quaternion is not None:
            x, y, z, w = quaternion  # of the optical frame about itself
            result.transform.rotation.w = q.w * w - q.x * x - q.y * y - q.z * z
            result.transform.rotation.x = q.w * x + q.x * w + q.y * z - q.z * y
            result.transform.rotation.y = q.w * y - q.x * z + q.y * w + q.z * x
            result.transform.rotation.z = q.w * z + q.x * y - q.y * x + q.z * w
        return result


class RegistrationInTheMiddle:
    """Stands between motion estimation and the registration; `alter(result)` may change an answer, or wait."""

    def __init__(self):
        self.alter = None
        self.unaltered = threading.local()
        self.service = rospy.Service("/registration/refine_pose", RefinePose, self.serve)

    def serve(self, request):
        for attempt in (0, 1):
            try:
                if not hasattr(self.unaltered, "call"):
                    self.unaltered.call = rospy.ServiceProxy("/registration/unaltered_refine_pose", RefinePose,
                                                             persistent=True)
                response = self.unaltered.call(request)
                break
            except rospy.ServiceException:
                del self.unaltered.call
                if attempt:
                    raise
        alter = self.alter
        if alter:
            alter(response.result)
        return response
