"""Runs the box and breaks it: the daemon on a real kernel under QEMU, with a broker beside it.

Every statement is about what a subscriber at the broker sees, with the times at which it saw
it. Ends by itself, with a summary line; exit code 0 when every check has passed.

    drive.py [--soak MINUTES | --raspberry-pi]
"""

import argparse
import datetime
import json
import pathlib
import signal
import statistics
import subprocess
import sys
import tempfile
import time

from machine import BOX, ROOT, X86, Box, Failed, RaspberryPi

# vivid's controls, drivers/media/test-drivers/vivid/vivid-ctrls.c.
DROPPED, DISCONNECT, FLAGGED = 0x00F0F040, 0x00F0F041, 0x00F0F042
REQBUFS, QBUF, STREAMON, FATAL = 0x00F0F043, 0x00F0F044, 0x00F0F045, 0x00F0F046
DRIVER = "/sys/bus/platform/drivers/vivid"
# The bars: a fault is reported within 20 s, and measured again 10 s after it is over.
NOTICED_S, BACK_S = 20.0, 10.0
# For what is not a bar: emulation beside other work.
PATIENCE_S = 120.0
# Resident memory may grow so much after warm-up.
WARM_MIN, GROWTH_KB = 5, 1024
# How long a picture of the recording stands (recording.toml, hardware-x86), and the time in which
# a window of them must have come.
PICTURE_S, RECORDING_MIN = 20, 6
# The whole run, so that a box that hangs is reported and not cut off.
LIMIT_S = 520


def is_density(kind, _message):
    return kind.startswith("density/")


def is_measured(message):
    return all(
        lane["density_veh_km"] is not None and lane["status"] == "oK" for lane in message["lanes"])


def measured(kind, message):
    return is_density(kind, message) and is_measured(message)


def null(kind, message):
    return is_density(kind, message) and message["lanes"][0]["density_veh_km"] is None


def status(name):
    return lambda kind, message: kind == "health" and message["status"] == name


def frames(message):
    return "{frames_used} of {frames_expected} frames".format(**message["lanes"][0])


class Checks:
    def __init__(self, box, window_s):
        """Windows are so long, end at full multiples of that, and are published then."""
        self.window_s = window_s
        self.box, self.broker, self.machine = box, box.broker, box.machine
        self.passed, self.failed = 0, []

    def run(self, name, check, *arguments):
        begun = time.monotonic()
        try:
            said = check(*arguments)
            self.passed += 1
            print(f"ok    {name}: {said} [{time.monotonic() - begun:.0f} s]", flush=True)
        except (Failed, LookupError, OSError, subprocess.SubprocessError) as failed:
            self.failed.append(name)
            print(f"FAIL  {name}: {failed!r}", flush=True)
            self.settle()

    def settle(self):
        """Back to a box that measures, so that one failure does not fail the rest."""
        for command in (f"echo vivid.0 > {DRIVER}/bind", "killall guest",
                        f"moving {self.machine.video}",
                        f"guest control {self.machine.video} {DROPPED:#x} 0"):
            self.machine.do(command, may_fail=True)
        try:
            self.broker.until("density", measured, PATIENCE_S)
        except Failed as failed:
            print(f"      and then: {failed}", flush=True)

    def first(self):
        begun = time.monotonic()
        self.broker.until("presence", lambda k, m: k == "presence" and "online" in str(m), PATIENCE_S)
        while True:
            _, message = self.broker.until("density", measured, PATIENCE_S)
            if message["lanes"][0]["frames_used"] >= 0.9 * message["lanes"][0]["frames_expected"]:
                break
        return f"density {time.monotonic() - begun:.1f} s after boot, {frames(message)}"

    def early_in_a_window(self):
        """Waits until a window has just ended."""
        if time.monotonic() - self.broker.heard.get(f"density/{self.window_s}s", 0.0) > 3:
            self.broker.until("density", is_density, PATIENCE_S)

    def density(self, since):
        """When density is there after `since`: with the window that is running, or else with
        the next, the first whole one, which takes its ten seconds and no more."""
        begun = since
        for _ in range(2):
            seconds, message = self.broker.until("density", is_density, self.window_s + 5, since)
            since += seconds
            if is_measured(message):
                return f"density {since - begun:.1f} s later ({frames(message)})"
        raise Failed(f"the first whole window has no density: {message}")

    def survives(self, *controls):
        """A fault that the stream recovers from at once: density goes on."""
        self.early_in_a_window()
        time.sleep(2)
        begun = time.monotonic()
        for control in controls:
            self.machine.control(control)
        return f"survived; {self.density(begun)}"

    def lasting(self, break_it, mend_it, meanwhile=None):
        """A fault that lasts: it is reported, and measured again after it is over."""
        begun = time.monotonic()
        break_it()
        told, _ = self.broker.until("sensorFailure", status("sensorFailure"), NOTICED_S, begun)
        seen = meanwhile() if meanwhile else ""
        # It ends as a window begins.
        self.broker.until("density null", null, 2 * self.window_s)
        mend_it()
        begun = time.monotonic()
        back, _ = self.broker.until("oK", status("oK"), BACK_S, begun)
        density = self.density(begun + back)
        return f"told after {told:.1f} s{seen}; measured again {back:.1f} s after it was over, {density}"

    def dropped(self):
        control = self.machine.control
        return self.lasting(lambda: control(DROPPED, 100), lambda: control(DROPPED, 0), self.blinks)

    def pull(self):
        self.machine.do(f"echo vivid.0 > {DRIVER}/unbind")

    def plug(self):
        self.machine.do(f"echo vivid.0 > {DRIVER}/bind && moving {self.machine.video}")

    def unplug(self):
        return self.lasting(self.pull, self.plug)

    def renumbered(self):
        """Unplugged, and back under another number behind the same name."""
        def reload():
            self.machine.video = "/dev/video3"
            self.machine.do("rmmod vivid && camera 3")
        said = self.lasting(self.pull, reload)
        if self.machine.do("readlink /dev/v4l/by-id/box") != "/dev/video3":
            raise Failed("it came back under its old number")
        return said + "; back as video3"

    def counted(self):
        """The faults so far, from the health message."""
        stream = self.broker.latest["health"]["stream"]
        if stream["flagged"] < 1 or stream["reopened"] < 5:
            raise Failed(f"{stream}")
        return f"{stream['flagged']} flagged, {stream['reopened']} reopened"

    def pin(self, name):
        """A pin's level, as the kernel sees it."""
        return self.machine.do(f"pin {name}")

    def blinks(self):
        levels, deadline = set(), time.monotonic() + 15
        while len(levels) < 2:
            levels.add(self.pin("lamp"))
            if time.monotonic() > deadline:
                raise Failed(f"the lamp stays at {levels}")
            time.sleep(0.2)
        return ", the lamp blinks"

    def pins(self):
        lamp, relay = self.pin("lamp"), self.pin("relay")
        if (lamp, relay) != ("1", "1"):
            raise Failed(f"lamp {lamp}, camera power {relay}")
        return "lamp lit and camera powered, as the kernel sees its lines"

    def temperature(self):
        def heated(celsius):
            self.machine.heat(celsius)
            return time.monotonic()
        board = self.broker.latest["health"]["board"]
        if board["enclosure_c"] != 25.5 or board["pace"] != "full":
            raise Failed(f"{board}")
        hot = lambda k, m: status("detectionAutoSuspended")(k, m) and m["board"]["pace"] == "stopped"
        told, _ = self.broker.until("stopped at 82 C", hot, NOTICED_S, heated(82.0))
        alarm = self.broker.latest.get("alarm/overheated", {})
        self.broker.until("density null", null, 2 * self.window_s)
        begun = heated(25.5)
        cool = lambda k, m: status("oK")(k, m) and m["board"]["pace"] == "full"
        back, _ = self.broker.until("oK", cool, NOTICED_S, begun)
        if not alarm.get("active") or self.broker.latest["alarm/overheated"]["active"]:
            raise Failed("the alarm overheated was not raised and cleared")
        return (f"25.5 C read; stopped {told:.1f} s after 82 C with an alarm, full pace {back:.1f} s "
                f"after 25.5 C, {self.density(begun + back)}")

    def hang(self):
        """The thread of the line stands still, the others go on: nobody feeds the watchdog."""
        self.machine.do("guest hang $(pidof verge) & sleep 1")
        begun = time.monotonic()
        uptime, *before = self.machine.wait_for_boot()
        reset = time.monotonic() - begun
        # WDIOF_CARDRESET; a kernel that restarted itself does not set it.
        if before != ["32"]:
            raise Failed(f"booted again, but not by the watchdog: {before}")
        begun = time.monotonic()
        self.broker.until("density", measured, PATIENCE_S, begun)
        return (f"reset by the watchdog after {reset:.0f} s (boot takes {uptime} s of it), "
                f"density {time.monotonic() - begun:.1f} s after boot")

    def no_fault(self):
        _, message = self.broker.until("density", measured, PATIENCE_S)
        health = self.broker.latest["health"]
        if (health["status"], health["alarm"], health["stage_faults"]) != ("oK", None, 0):
            raise Failed(f"{health}")
        return f"density of {len(message['lanes'])} lanes, no alarm, {health['frames']['measured']} frames"

    def rss_kb(self):
        return int(self.machine.do("awk '/VmRSS/ { print $2 }' /proc/$(pidof verge)/status"))

    def soak(self, minutes):
        """A fault each minute; resident memory after warm-up and at most after it."""
        control, do = self.machine.control, self.machine.do
        faults = [
            (lambda: control(FLAGGED), None),
            (lambda: (control(REQBUFS), control(FATAL)), None),
            (lambda: control(QBUF), None),
            (lambda: (control(STREAMON), control(FATAL)), None),
            (lambda: control(FATAL), None),
            (lambda: control(DROPPED, 100), lambda: control(DROPPED, 0)),
            (lambda: control(DISCONNECT), None),
            (self.pull, self.plug),
        ]
        pid, rss, begun = do("pidof verge"), [], time.monotonic()
        for minute in range(minutes):
            make, mend = faults[minute % len(faults)]
            make()
            time.sleep(20)
            if mend:
                mend()
            time.sleep(begun + 60 * (minute + 1) - time.monotonic())
            rss.append(self.rss_kb())
            print(f"      minute {minute + 1}: {rss[-1]} kB", flush=True)
            while not self.broker.messages.empty():
                self.broker.messages.get()
        if len(rss) <= WARM_MIN:
            raise Failed(f"give more than {WARM_MIN} minutes")
        if do("pidof verge") != pid:
            raise Failed("the daemon was restarted")
        warm, grown = rss[WARM_MIN - 1], max(rss[WARM_MIN:]) - rss[WARM_MIN - 1]
        said = f"{minutes} min, a fault each: resident {warm} kB after {WARM_MIN} min, then at most {grown:+} kB"
        if grown > GROWTH_KB:
            raise Failed(said)
        return said

    def faults(self):
        self.run("vivid 1, dropped buffers", self.dropped)
        self.run("vivid 2, damaged buffer", self.survives, FLAGGED)
        self.run("vivid 3, REQBUFS error", self.survives, REQBUFS, FATAL)
        self.run("vivid 4, QBUF error", self.survives, QBUF)
        self.run("vivid 5, STREAMON error", self.survives, STREAMON, FATAL)
        self.run("vivid 6, fatal streaming error", self.survives, FATAL)
        # vivid is there again when its last user has let go of it.
        self.run("vivid 7, disconnect", self.survives, DISCONNECT)
        self.run("unplugged and replugged", self.unplug)
        self.run("faults are counted", self.counted)
        self.run("back under another number", self.renumbered)
        self.run("thermometer and derating", self.temperature)
        self.run("pins", self.pins)


def lanes(message):
    return [(lane["density_veh_km"], lane["vehicles_mean"]) for lane in message["lanes"]]


def alike(measured, expected):
    """To the four digits that a message has."""
    return all(abs(a - b) < 2e-4 for one, other in zip(measured, expected) for a, b in zip(one, other))


def replayed(minutes):
    """The lanes of each picture when the recording is replayed over and over, as the camera in
    the box plays it: what a picture counts depends on the road seen before it."""
    root = BOX / "root-x86"
    etc = root / "etc"
    pictures = sorted((etc / "frames").iterdir())
    with tempfile.TemporaryDirectory() as folder:
        for number in range(60 * minutes // PICTURE_S):
            time_of = datetime.datetime(2026, 1, 5) + datetime.timedelta(seconds=PICTURE_S * number)
            link = pathlib.Path(folder, time_of.strftime("%Y%m%dT%H%M%S.000Z.jpg"))
            link.symlink_to(pictures[number % len(pictures)])
        said = subprocess.run(
            [root / "bin/verge", "replay", "--json", "--window", str(PICTURE_S), "--interval", str(PICTURE_S),
             "--table", etc / "curve.lut", "--model", etc / "model/verge_nanodet_640x480.toml",
             "--frames", folder],
            check=True, capture_output=True, text=True, cwd=ROOT).stdout
    return [lanes(json.loads(line)) for line in said.splitlines()]


def recording(box):
    """Street frames through V4L2: a window holds the whole recording once, so that its density
    is that of the same frames replayed beside the box."""
    each = replayed(RECORDING_MIN)
    held = 60 // PICTURE_S
    expected = [
        [tuple(statistics.fmean(number) for number in zip(*lane)) for lane in zip(*each[first:first + held])]
        for first in range(len(each) - held + 1)]
    for _ in range(RECORDING_MIN - 1):
        _, message = box.broker.until("density", is_density, 60 * RECORDING_MIN, box.begun)
        # A picture that was taken twice, or not, makes another window.
        if is_measured(message) and any(alike(lanes(message), window) for window in expected):
            break
    else:
        raise Failed(f"{lanes(message)} in place of one of {expected}")
    box.machine.wait_for_boot()
    health = box.broker.latest["health"]
    if health["camera"]["aim"] != "in_place":
        raise Failed(f"{health['camera']}")
    turn = box.machine.do("awk 'index($1, \"verge_turn_duration_seconds{\") == 1 { print $2 }' /run/metrics")
    densities = ", ".join(f"{density:.1f}" for density, _ in lanes(message))
    return (f"{densities} veh/km as when replayed ({frames(message)}), camera in place, "
            f"{float(turn):.1f} s a picture")


def stopped(number, _frame):
    raise SystemExit(f"box: FAILED: stopped by {signal.Signals(number).name}, see above")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--soak", type=int, metavar="MINUTES", help="only the long run")
    parser.add_argument("--raspberry-pi", action="store_true", help="the second board instead")
    arguments = parser.parse_args()
    begun = time.monotonic()
    signal.signal(signal.SIGTERM, stopped)
    signal.signal(signal.SIGALRM, stopped)
    signal.alarm(LIMIT_S + 60 * (arguments.soak or 0))
    if arguments.raspberry_pi:
        boxes, window_s = [Box("raspberry-pi", RaspberryPi)], 30
    else:
        boxes, window_s = [Box("soak" if arguments.soak else "box", X86)], 10
    checks = Checks(boxes[0], window_s)
    whole = False
    try:
        uptime, *_ = boxes[0].machine.wait_for_boot()
        boxes[0].machine.heat(25.5)
        print(f"boot: {uptime} s in the box, {time.monotonic() - begun:.1f} s beside it", flush=True)
        checks.run("boots and measures", checks.first)
        if arguments.soak:
            checks.run("memory", checks.soak, arguments.soak)
        elif arguments.raspberry_pi:
            checks.run("vivid 1, dropped buffers", checks.dropped)
            checks.run("thermometer and derating", checks.temperature)
            checks.run("pins", checks.pins)
            checks.run("in the end", checks.no_fault)
        else:
            checks.faults()
            # The second box works while the first waits for its watchdog.
            boxes.append(Box("recording", X86, camera="recording"))
            checks.run("hung stage, hardware watchdog", checks.hang)
            checks.run("in the end", checks.no_fault)
            checks.run("a recording as camera, the detector that ships", recording, boxes[1])
        whole = not checks.failed
    finally:
        for box in boxes:
            box.stop()
            if not whole:
                box.tell_logs()
    seconds = time.monotonic() - begun
    print(f"box: {checks.passed} passed, {len(checks.failed)} failed {checks.failed or ''} in {seconds:.0f} s")
    return 1 if checks.failed else 0


if __name__ == "__main__":
    sys.exit(main())
