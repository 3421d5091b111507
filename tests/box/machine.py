"""The box's two ends: the virtual machine, and a broker that hears what it publishes."""

import json
import pathlib
import queue
import shutil
import socket
import subprocess
import threading
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
BOX = ROOT / "target/box"
# Where vivid stands after boot.
VIDEO = "/dev/video0"


class Failed(Exception):
    pass


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


class Broker:
    """A broker on loopback and everything that is published there, with its time."""

    def __init__(self, folder, log):
        self.port = free_port()
        conf = folder / "mosquitto.conf"
        conf.write_text(f"listener {self.port} 127.0.0.1\nallow_anonymous true\n")
        mosquitto = shutil.which("mosquitto") or "/usr/sbin/mosquitto"
        log = open(log, "w")
        self.broker = subprocess.Popen([mosquitto, "-c", conf], stdout=log, stderr=log)
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
    """The virtual machine, with its shell on a serial line."""

    def __init__(self, folder, port, console):
        self.video = VIDEO
        release = (BOX / "release").read_text().strip()
        shell = folder / "shell"
        busybox = shutil.which("busybox")
        self.console = open(console, "w")
        self.process = subprocess.Popen(
            ["qemu-system-x86_64", "-accel", "tcg", "-machine", "q35", "-cpu", "max", "-m", "1024",
             "-nodefaults", "-display", "none", "-serial", "stdio",
             "-chardev", f"socket,id=shell,path={shell},server=on,wait=off",
             "-serial", "chardev:shell",
             "-device", "i6300esb", "-action", "watchdog=reset",
             "-netdev", f"user,id=n,restrict=on,guestfwd=tcp:10.0.2.100:1883-cmd:{busybox} nc 127.0.0.1 {port}",
             "-device", "virtio-net-pci,netdev=n,romfile=",
             "-kernel", BOX / f"kernel/boot/vmlinuz-{release}", "-initrd", BOX / "initramfs",
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
                said = self.shell.recv(4096)
            except TimeoutError:
                raise Failed(f"the box says nothing for {limit_s:.0f} s") from None
            if not said:
                raise Failed("the box has ended")
            self.text += said
        line, self.text = self.text.split(b"\n", 1)
        return line.decode(errors="replace").strip("\r ")

    def wait_for_boot(self, limit_s=180):
        """What the first process says when it listens: seconds since the kernel's start, and
        what the watchdog says of the time before."""
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
