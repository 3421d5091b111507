"""The box's two ends: the virtual machine, and a broker that hears what it publishes."""

import json
import pathlib
import queue
import shutil
import socket
import subprocess
import tempfile
import threading
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
BOX = ROOT / "target/box"
# State of vivid after boot.
VIDEO = "/dev/video0"


class Failed(Exception):
    pass


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


def connected(path):
    """A connection to a socket that is about to be there."""
    for _ in range(100):
        if path.exists():
            break
        time.sleep(0.1)
    connection = socket.socket(socket.AF_UNIX)
    connection.connect(str(path))
    return connection


class Broker:
    """A broker on loopback and everything that is published there, with its time."""

    def __init__(self, folder, log):
        self.port = free_port()
        conf = folder / "mosquitto.conf"
        conf.write_text(f"listener {self.port} 127.0.0.1\nallow_anonymous true\n")
        mosquitto = shutil.which("mosquitto") or "/usr/sbin/mosquitto"
        with open(log, "w") as out:
            self.broker = subprocess.Popen([mosquitto, "-c", conf], stdout=out, stderr=out)
        self.wait_for_port()
        self.reader = subprocess.Popen(
            ["mosquitto_sub", "-p", str(self.port), "-t", "verge/#", "-F", "%t %p"],
            stdout=subprocess.PIPE, text=True)
        self.messages, self.latest, self.heard = queue.Queue(), {}, {}
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
            self.latest[kind], self.heard[kind] = message, time.monotonic()
            self.messages.put((self.heard[kind], kind, message))

    def until(self, what, wanted, limit_s, since=None):
        """The seconds after `since` at which a message came that `wanted(kind, message)`."""
        since = time.monotonic() if since is None else since
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
    """A virtual machine, with its shell on a serial line."""

    def __init__(self, folder, port, console):
        self.video = VIDEO
        shell = folder / "shell"
        network = (f"user,id=n,restrict=on,guestfwd=tcp:10.0.2.100:1883-cmd:"
                   f"{shutil.which('busybox')} nc 127.0.0.1 {port}")
        self.console = open(console, "w")
        self.process = subprocess.Popen(
            [*self.command(folder), "-nodefaults", "-display", "none", "-serial", "stdio",
             "-chardev", f"socket,id=shell,path={shell},server=on,wait=off", "-serial", "chardev:shell",
             "-netdev", network],
            stdin=subprocess.DEVNULL, stdout=self.console, stderr=subprocess.STDOUT)
        self.shell, self.text = connected(shell), b""

    def line(self, limit_s):
        deadline = time.monotonic() + limit_s
        while b"\n" not in self.text:
            self.shell.settimeout(max(deadline - time.monotonic(), 0.01))
            try:
                said = self.shell.recv(4096)
            except TimeoutError:
                raise Failed(f"the box says nothing for {limit_s:.0f} s") from None
            if not said:
                raise Failed(f"the box has ended: {self.process.wait(10)}")
            self.text += said
        line, self.text = self.text.split(b"\n", 1)
        return line.decode(errors="replace").strip("\r ")

    def wait_for_boot(self, limit_s=180):
        """The first process's words when it listens: seconds since the kernel's start, and the
        watchdog's boot status."""
        deadline = time.monotonic() + limit_s
        while "@boot" not in (line := self.line(deadline - time.monotonic())):
            pass
        self.video = VIDEO
        return line.split("@boot", 1)[1].split()

    def do(self, command, limit_s=60, may_fail=False):
        self.shell.sendall(command.encode() + b"\n")
        said, _, code = self.line(limit_s).rpartition("@")
        if code != "0" and not may_fail:
            raise Failed(f"{command}: {said} ({code})")
        return said.strip()

    def control(self, control, value=1):
        self.do(f"guest control {self.video} {control:#x} {value}")

    def stop(self):
        self.process.kill()
        self.process.wait(10)


class X86(Machine):
    """An x86 industrial PC. What it lacks is made by the kernel's own simulators."""

    def __init__(self, *where, camera="vivid"):
        self.camera = camera
        super().__init__(*where)

    def command(self, _folder):
        release = (BOX / "release").read_text().strip()
        return ["qemu-system-x86_64", "-accel", "tcg", "-machine", "q35", "-cpu", "max", "-m", "1024",
                "-device", "i6300esb", "-action", "watchdog=reset",
                "-device", "virtio-net-pci,netdev=n,romfile=",
                "-kernel", BOX / f"kernel/boot/vmlinuz-{release}", "-initrd", BOX / "initramfs-x86",
                "-append", f"console=ttyS0 quiet panic=-1 no_timer_check box.camera={self.camera}"]

    def heat(self, celsius):
        """LM75 sends the high byte first, an SMBus word has the low one first."""
        word = int.from_bytes(int(celsius * 256).to_bytes(2, "big"), "little")
        self.do(f"guest word /dev/i2c-$(cat /run/bus) 0x48 0x00 {word:#06x}")


class RaspberryPi(Machine):
    """QEMU's Raspberry Pi 3B: its pins, its I2C bus with a sensor, a network on USB."""

    def command(self, folder):
        release = (BOX / "pi/release").read_text().strip()
        self.qmp = folder / "qmp"
        tree = BOX / f"pi/usr/lib/linux-image-{release}/broadcom/bcm2837-rpi-3-b.dtb"
        return ["qemu-system-aarch64", "-accel", "tcg", "-machine", "raspi3b",
                "-device", "tmp105,id=thermometer,bus=i2c-bus.1,address=0x48",
                "-device", "usb-net,netdev=n", "-qmp", f"unix:{self.qmp},server=on,wait=off",
                "-kernel", BOX / f"pi/boot/vmlinuz-{release}", "-dtb", tree,
                "-initrd", BOX / "initramfs-raspberry-pi",
                "-append", "console=ttyAMA0 console=ttyAMA1 quiet panic=-1"]

    def heat(self, celsius):
        """The surroundings of the sensor, set from outside the machine."""
        with connected(self.qmp) as qmp, qmp.makefile("rw") as said:
            path = {"path": "/machine/peripheral/thermometer", "property": "temperature"}
            for command in ({"execute": "qmp_capabilities"},
                            {"execute": "qom-set", "arguments": {**path, "value": int(celsius * 1000)}}):
                print(json.dumps(command), file=said, flush=True)
                while "return" not in (answer := json.loads(said.readline())):
                    if "error" in answer:
                        raise Failed(f"{command}: {answer}")


class Box:
    """A machine and its broker."""

    def __init__(self, name, machine, **hardware):
        self.logs = {BOX / f"{name}-console.log": 80, BOX / f"{name}-broker.log": 20}
        console, log = self.logs
        self.begun = time.monotonic()
        self.folder = tempfile.TemporaryDirectory()
        folder = pathlib.Path(self.folder.name)
        self.broker = Broker(folder, log)
        self.machine = machine(folder, self.broker.port, console, **hardware)

    def tell_logs(self):
        for log, lines in self.logs.items():
            text = log.read_text(errors="replace").splitlines()[-lines:]
            print(f"---- the end of {log}", *text, sep="\n", flush=True)

    def stop(self):
        self.machine.stop()
        self.broker.stop()
        self.folder.cleanup()
