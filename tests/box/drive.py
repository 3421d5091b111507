"""Runs the box and breaks it: the daemon on a real kernel under QEMU, with a broker beside it.

Every statement is about what a subscriber at the broker sees, with the times at which it saw
it. Ends by itself, with a summary line; exit code 0 when every check has passed.

    drive.py [--soak MINUTES]
"""

import argparse
import json
import pathlib
import queue
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
BOX = ROOT / "target/box"
VIDEO = "/dev/video0"
# vivid's controls, drivers/media/test-drivers/vivid/vivid-ctrls.c.
DISCONNECT, DROPPED, FLAGGED = 0x00F0F041, 0x00F0F040, 0x00F0F042
REQBUFS, QBUF, STREAMON, FATAL = 0x00F0F043, 0x00F0F044, 0x00F0F045, 0x00F0F046
# The bars: a fault is told within 20 s, and measured again 10 s after it is over.
NOTICED_S, BACK_S = 20.0, 10.0
# A window of 10 s that begins after recovery has ended by then, with 2 s for slow emulation.
WINDOW_S = 22.0


class Failed(Exception):
    pass


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


class Broker:
    """A broker on loopback and everything that is published there, with its time."""

    def __init__(self, folder):
        self.port = free_port()
        conf = folder / "mosquitto.conf"
        conf.write_text(f"listener {self.port} 127.0.0.1\nallow_anonymous true\n")
        mosquitto = shutil.which("mosquitto") or "/usr/sbin/mosquitto"
        log = open(BOX / "broker.log", "w")
        self.broker = subprocess.Popen([mosquitto, "-c", conf], stdout=log, stderr=log)
        self.wait_for_port()
        self.reader = subprocess.Popen(
            ["mosquitto_sub", "-p", str(self.port), "-t", "verge/#", "-F", "%t %p"],
            stdout=subprocess.PIPE, text=True)
        self.seen, self.messages = [], queue.Queue()
        threading.Thread(target=self.read, daemon=True).start()

    def wait_for_port(self):
        for _ in range(100):
            try:
                socket.create_connection(("127.0.0.1", self.port), 1).close()
                return
            except OSError:
                time.sleep(0.1)
        raise Failed("the broker does not listen")

    def read(self):
        for line in self.reader.stdout:
            topic, _, payload = line.partition(" ")
            kind = topic.split("/", 2)[2]
            body = payload.strip()
            message = json.loads(body) if body.startswith("{") else body
            self.messages.put((time.monotonic(), kind, message))

    def until(self, what, wanted, limit_s, since=None):
        """The seconds after `since` at which a message came that `wanted(kind, message)`."""
        since = since or time.monotonic()
        while True:
            rest = since + limit_s - time.monotonic()
            try:
                when, kind, message = self.messages.get(timeout=max(rest, 0.01))
            except queue.Empty:
                raise Failed(f"{what}: not seen within {limit_s:.0f} s") from None
            if when >= since and wanted(kind, message):
                return when - since, message

    def stop(self):
        for process in (self.reader, self.broker):
            process.terminate()
            process.wait(10)


class Machine:
    """The virtual machine, with its shell on a serial line."""

    def __init__(self, folder, port):
        release = (BOX / "release").read_text().strip()
        shell = folder / "shell"
        busybox = shutil.which("busybox")
        self.console = open(BOX / "console.log", "w")
        self.process = subprocess.Popen(
            ["qemu-system-x86_64", "-accel", "tcg", "-machine", "q35", "-cpu", "max", "-m", "1024",
             "-nodefaults", "-display", "none", "-serial", "stdio",
             "-chardev", f"socket,id=shell,path={shell},server=on,wait=off",
             "-serial", "chardev:shell",
             "-device", "i6300esb", "-action", "watchdog=reset",
             "-netdev", f"user,id=n,restrict=on,guestfwd=tcp:10.0.2.100:1883-cmd:{busybox} nc 127.0.0.1 {port}",
             "-device", "virtio-net-pci,netdev=n,romfile=",
             "-kernel", BOX / f"kernel/boot/vmlinuz-{release}", "-initrd", BOX / "initramfs.gz",
             "-append", "console=ttyS0 quiet panic=-1 no_timer_check"],
            stdin=subprocess.DEVNULL, stdout=self.console, stderr=subprocess.STDOUT)
        for _ in range(100):
            if shell.exists():
                break
            time.sleep(0.1)
        self.shell = socket.socket(socket.AF_UNIX)
        self.shell.connect(str(shell))
        self.text = b""

    def line(self, limit_s):
        deadline = time.monotonic() + limit_s
        while b"\n" not in self.text:
            self.shell.settimeout(max(deadline - time.monotonic(), 0.01))
            try:
                self.text += self.shell.recv(4096)
            except TimeoutError:
                raise Failed(f"the box says nothing for {limit_s:.0f} s") from None
        line, self.text = self.text.split(b"\n", 1)
        return line.decode(errors="replace").strip("\r ")

    def wait_for_boot(self, limit_s=90):
        while "@boot" not in (line := self.line(limit_s)):
            pass
        return line

    def do(self, command, limit_s=20, may_fail=False):
        self.shell.sendall(command.encode() + b"\n")
        said, _, code = self.line(limit_s).rpartition("@")
        if code != "0" and not may_fail:
            raise Failed(f"{command}: {said} ({code})")
        return said.strip()

    def control(self, control, value=1):
        self.do(f"guest control {VIDEO} {control:#x} {value}")

    def stop(self):
        self.process.kill()
        self.process.wait(10)


def status(name):
    return lambda kind, m: kind == "health" and m["status"] == name


def measured(kind, m):
    return kind.startswith("density/") and all(
        lane["density_veh_km"] is not None and lane["status"] == "oK" for lane in m["lanes"])


class Checks:
    def __init__(self, broker, machine):
        self.broker, self.machine = broker, machine
        self.passed, self.failed = 0, []

    def run(self, name, check):
        try:
            said = check()
            self.passed += 1
            print(f"ok    {name}: {said}", flush=True)
        except (Failed, LookupError, OSError) as failed:
            self.failed.append(name)
            print(f"FAIL  {name}: {failed!r}", flush=True)
            self.settle()

    def settle(self):
        """Back to a box that measures, so that one failure does not fail the rest."""
        for command in ("echo vivid.0 > /sys/bus/platform/drivers/vivid/bind",
                        f"guest control {VIDEO} {DROPPED:#x} 0", "killall -CONT verge"):
            self.machine.do(command, may_fail=True)

    def density_again(self):
        """A whole window after now."""
        begun = time.monotonic()
        return self.broker.until("density", measured, WINDOW_S, begun)[0]

    def counted(self, key, more_than, limit_s=75):
        """The health message, each minute, counts more of `key` than that."""
        wanted = lambda kind, m: kind == "health" and m["stream"][key] > more_than
        return self.broker.until(f"stream.{key}", wanted, limit_s)[1]["stream"][key]

    def first(self):
        begun = time.monotonic()
        self.broker.until("presence", lambda k, m: k == "presence" and "online" in str(m), 60)
        seconds, message = self.broker.until("density", measured, 60, begun)
        frames = message["lanes"][0]["frames_used"]
        if frames < 9:
            raise Failed(f"{frames} frames in 10 s: the box is too slow")
        return f"density {seconds:.1f} s after boot, {frames} of 10 frames"

    def survives(self, controls):
        """A fault that the stream recovers from at once: density goes on."""
        begun = time.monotonic()
        for control in controls:
            self.machine.control(control)
        seconds = self.broker.until("density", measured, BACK_S + WINDOW_S, begun)[0]
        return f"survived; density of a whole window {seconds:.1f} s later"

    def lasting(self, break_it, mend_it):
        """A fault that lasts: it is told, and measured again after it is over."""
        break_it()
        told, _ = self.broker.until("sensorFailure", status("sensorFailure"), NOTICED_S)
        null = lambda k, m: k.startswith("density/") and m["lanes"][0]["density_veh_km"] is None
        self.broker.until("density null", null, 2 * WINDOW_S)
        mend_it()
        begun = time.monotonic()
        back, _ = self.broker.until("oK", status("oK"), BACK_S, begun)
        density = self.broker.until("density", measured, BACK_S + WINDOW_S, begun)[0]
        return f"told after {told:.1f} s, measured again {back:.1f} s after it was over, density {density:.1f} s"

    def dropped(self):
        control = self.machine.control
        return self.lasting(lambda: control(DROPPED, 100), lambda: control(DROPPED, 0))

    def renumbered(self):
        """Unplugged, and back under another number behind the same name."""
        def reload():
            self.machine.do("rmmod vivid", 30)
            self.machine.do(f"modprobe vivid n_devs=1 node_types=0x1 num_inputs=1 input_types=0x0 vid_cap_nr=3"
                            " && ln -sfn /dev/video3 /dev/v4l/by-id/box", 30)
            self.machine.do("guest control /dev/video3 0x00f0f002 5")
        driver = "/sys/bus/platform/drivers/vivid"
        said = self.lasting(lambda: self.machine.do(f"echo vivid.0 > {driver}/unbind"), reload)
        global VIDEO
        VIDEO = "/dev/video3"
        return said + "; back as video3"

    def unplug(self):
        driver = "/sys/bus/platform/drivers/vivid"
        return self.lasting(lambda: self.machine.do(f"echo vivid.0 > {driver}/unbind"),
                            lambda: self.machine.do(f"echo vivid.0 > {driver}/bind"))

    def temperature(self):
        def set_word(word):
            self.machine.do(f"guest word /dev/i2c-$(cat /run/bus) 0x48 0x00 {word:#06x}")
        reads = lambda c: lambda k, m: k == "health" and m["board"]["enclosure_c"] == c
        self.broker.until("25.5 C", reads(25.5), 75)
        set_word(0x0052)
        hot = lambda k, m: status("detectionAutoSuspended")(k, m) and m["board"]["pace"] == "stopped"
        told, _ = self.broker.until("stopped at 82 C", hot, NOTICED_S)
        set_word(0x8019)
        back, _ = self.broker.until("oK", lambda k, m: status("oK")(k, m) and m["board"]["pace"] == "full", 20)
        density = self.density_again()
        return (f"25.5 C read; stopped {told:.1f} s after 82 C, full pace {back:.1f} s after 25.5 C, "
                f"density {density:.1f} s later")

    def pins(self):
        gpio = self.machine.do("cat /run/gpio", may_fail=True)
        if not gpio.startswith("/sys"):
            raise Failed("gpio-sim was not built")
        led, relay = (self.machine.do(f"cat {gpio}/sim_gpio{n}/value") for n in (0, 1))
        if (led, relay) != ("1", "1"):
            raise Failed(f"lamp {led}, camera power {relay}")
        return "lamp lit and camera powered, as the kernel sees its lines"

    def hang(self):
        self.machine.do("killall -STOP verge")
        begun = time.monotonic()
        boot = self.machine.wait_for_boot(120)
        reset = time.monotonic() - begun
        begun = time.monotonic()
        density = self.broker.until("density", measured, 60, begun)[0]
        return f"the watchdog reset the box after {reset:.0f} s, density {density:.1f} s after boot ({boot})"

    def no_fault(self):
        self.broker.until("a health message", status("oK"), 75)
        _, m = self.broker.until("density", measured, WINDOW_S)
        return f"density of {len(m['lanes'])} lanes"

    def rss_kb(self):
        return int(self.machine.do("awk '/VmRSS/ { print $2 }' /proc/$(pidof verge)/status"))

    def soak(self, minutes):
        """A fault each minute; resident memory after warm-up and at the end."""
        faults = [[FLAGGED], [FATAL], [REQBUFS, FATAL], [QBUF], [STREAMON, FATAL], [DROPPED]]
        warm, most, begun = None, 0, time.monotonic()
        for minute in range(minutes):
            for control in faults[minute % len(faults)]:
                self.machine.control(control, 100 if control == DROPPED else 1)
            time.sleep(20)
            self.machine.control(DROPPED, 0)
            while time.monotonic() < begun + 60 * (minute + 1):
                time.sleep(1)
            rss = self.rss_kb()
            if minute == 4:
                warm = rss
            most = max(most, rss) if warm else most
            print(f"      minute {minute + 1}: {rss} kB", flush=True)
            while not self.broker.messages.empty():
                self.broker.messages.get()
        if warm is None:
            raise Failed("give at least 6 minutes")
        if most - warm > 1024:
            raise Failed(f"resident memory grew by {most - warm} kB after warm-up")
        return f"{minutes} min, a fault each minute: resident {warm} kB after 5 min, at most {most - warm} kB more"


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--soak", type=int, metavar="MINUTES", help="only the long run")
    arguments = parser.parse_args()
    begun = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        broker = Broker(folder)
        machine = None
        try:
            machine = Machine(folder, broker.port)
            machine.wait_for_boot()
            checks = Checks(broker, machine)
            checks.run("boots and measures", checks.first)
            if arguments.soak:
                checks.run("memory", lambda: checks.soak(arguments.soak))
            else:
                checks.run("vivid 1, dropped buffers", checks.dropped)
                checks.run("vivid 2, damaged buffer", lambda: checks.survives([FLAGGED]))
                checks.run("vivid 3, REQBUFS error", lambda: checks.survives([REQBUFS, FATAL]))
                checks.run("vivid 4, QBUF error", lambda: checks.survives([QBUF]))
                checks.run("vivid 5, STREAMON error", lambda: checks.survives([STREAMON, FATAL]))
                checks.run("vivid 6, fatal streaming error", lambda: checks.survives([FATAL]))
                checks.run("faults are counted", lambda: f"{checks.counted('flagged', 0)} flagged, "
                           f"{checks.counted('reopened', 4)} reopened")
                checks.run("unplugged and replugged", checks.unplug)
                # vivid is there again when its last user has let go of it.
                checks.run("vivid 7, disconnect", lambda: checks.survives([DISCONNECT]))
                checks.run("back under another number", checks.renumbered)
                checks.run("thermometer and derating", checks.temperature)
                checks.run("pins", checks.pins)
                checks.run("hung stage, hardware watchdog", checks.hang)
                checks.run("in the end", checks.no_fault)
        finally:
            if machine:
                machine.stop()
            broker.stop()
    seconds = time.monotonic() - begun
    print(f"box: {checks.passed} passed, {len(checks.failed)} failed {checks.failed or ''} in {seconds:.0f} s")
    return 1 if checks.failed else 0


if __name__ == "__main__":
    sys.exit(main())
