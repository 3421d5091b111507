"""Drives the I/O node in QEMU and checks its outputs.

The daemon writes to a pseudo-terminal, as it would to a USB adapter; this program carries the
bytes on to the emulated UART, and can cut or garble them. Outputs are read from the board's LED
register through QMP. Own code only: no package beside Python's own is needed.
"""

import json
import os
import pathlib
import pty
import random
import select
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import tty

FIRMWARE, VERGE = sys.argv[1], sys.argv[2]
ROOT = pathlib.Path(__file__).resolve().parents[2]
LED_REGISTER = 0x4002F004
STACK = (0x20000000, 40 << 10)
# How far the stack may grow of what memory.x gives it.
STACK_LIMIT = 0.75
# Limits are twice the time that is set: on a busy machine emulated time runs slower.
HOLD_S = 22
# Length of lane 2 in tests/data/curve.lut.
LANE_2_M = 84.0
WINDOW_S = 10
PAINT = 0xA5


class Qemu:
    """The board: QEMU with its UART on a socket and QMP on another."""

    def __init__(self, folder):
        self.folder = folder
        # Memory that the stack has not touched since the last reset stays painted.
        (folder / "paint").write_bytes(bytes([PAINT]) * STACK[1])
        self.uart_path = str(folder / "uart")
        qmp_path = str(folder / "qmp")
        # One instruction takes 32 ns, about a cycle at the board's 25 MHz, so that times inside are
        # the emulated core's and not this machine's.
        self.process = subprocess.Popen(
            ["qemu-system-arm", "-M", "mps2-an386", "-accel", "tcg", "-icount", "shift=5",
             "-display", "none", "-monitor", "none", "-kernel", FIRMWARE,
             "-action", "watchdog=reset",
             "-device", f"loader,addr={STACK[0]},file={folder / 'paint'},force-raw=on",
             "-gdb", f"unix:{folder / 'gdb'},server=on,wait=off",
             "-serial", f"unix:{self.uart_path},server=on,wait=off",
             "-qmp", f"unix:{qmp_path},server=on,wait=off", "-S"])
        self.qmp = connect(qmp_path).makefile("rw")
        json.loads(self.qmp.readline())
        self.ask("qmp_capabilities")
        self.uart = connect(self.uart_path)

    def ask(self, command, **arguments):
        self.qmp.write(json.dumps({"execute": command, "arguments": arguments}) + "\n")
        self.qmp.flush()
        while True:
            answer = json.loads(self.qmp.readline())
            if "return" in answer:
                return answer["return"]
            if "error" in answer:
                raise RuntimeError(f"{command}: {answer['error']}")

    def monitor(self, line):
        return self.ask("human-monitor-command", **{"command-line": line})

    def outputs(self):
        """The states of the eight outputs, bit 0 is output 1."""
        return int(self.monitor(f"xp /1wx {LED_REGISTER}").split()[-1], 16) & 0xFF

    def memory(self, address, length):
        path = self.folder / "memory"
        self.ask("pmemsave", val=address, size=length, filename=str(path))
        return path.read_bytes()

    def hang(self):
        """Lets the core run in a loop of one instruction, `b .`, as a program does that hangs."""
        gdb = connect(str(self.folder / "gdb"))

        def ask(text):
            gdb.sendall(f"${text}#{sum(text.encode()) % 256:02x}".encode())
            answer = b""
            while b"#" not in answer:
                answer += gdb.recv(4096)
            gdb.sendall(b"+")
            return answer

        free = 0x2000AF00
        ask("?")
        # QEMU takes single registers only from a debugger that has read their description.
        ask("qXfer:features:read:target.xml:0,ffb")
        assert b"OK" in ask(f"M{free:x},2:fee7")
        assert b"OK" in ask(f"Pf={free.to_bytes(4, 'little').hex()}")
        ask("D")
        gdb.close()

    def stop(self):
        self.process.terminate()
        self.process.wait(10)


def connect(path):
    for _ in range(100):
        try:
            end = socket.socket(socket.AF_UNIX)
            end.connect(path)
            return end
        except OSError:
            end.close()
            time.sleep(0.1)
    raise RuntimeError(f"{path}: nobody listens")


class Cable:
    """A pseudo-terminal for the daemon whose other end is the board's UART."""

    def __init__(self, uart):
        self.uart = uart
        self.master, slave = pty.openpty()
        tty.setraw(slave)
        self.device = os.ttyname(slave)
        self.slave = slave
        self.cut = False
        self.garble = None
        self.bytes = 0
        self.running = True
        self.thread = threading.Thread(target=self.carry, daemon=True)
        self.thread.start()

    def carry(self):
        while self.running:
            ready, _, _ = select.select([self.master, self.uart], [], [], 0.1)
            if self.master in ready:
                data = bytearray(os.read(self.master, 4096))
                self.bytes += len(data)
                if self.garble:
                    for at in range(len(data)):
                        if self.garble.random() < 0.02:
                            data[at] = self.garble.randrange(256)
                if not self.cut:
                    self.uart.sendall(data)
            if self.uart in ready:
                data = self.uart.recv(4096)
                if not self.cut:
                    os.write(self.master, data)


def node(cable, *arguments):
    """The output of `verge node`."""
    command = [VERGE, "node", "--device", cable.device, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=30)
    return done.returncode, done.stdout, done.stderr


def counters(cable):
    code, out, err = node(cable, "counters")
    assert code == 0, err
    return {line.split(" = ")[0]: int(line.split(" = ")[1]) for line in out.splitlines()}


def until(what, seconds, wanted):
    """Waits for a condition; returns how long it took."""
    began = time.monotonic()
    while time.monotonic() - began < seconds:
        if wanted():
            return time.monotonic() - began
        time.sleep(0.05)
    raise AssertionError(f"{what}: not within {seconds} s")


PASSED = []


def check(what):
    def decorate(run):
        def again(*arguments):
            began = time.monotonic()
            said = run(*arguments)
            PASSED.append(what)
            print(f"ok {len(PASSED):2} {what} ({said + ', ' if said else ''}"
                  f"{time.monotonic() - began:.1f} s)", flush=True)
        return again
    return decorate


def recording(folder):
    """Pictures of the street in blocks of 30 s, one a second: many vehicles in lane 2, then few.
    Returns the folder, and the mean of each kind in vehicles."""
    frames = ROOT / "tests/data/curve/frames"
    truth = [json.loads(line) for line in open(ROOT / "tests/data/curve/truth.jsonl")]
    # The part of the lane that the table covers.
    count = {t["frame"]: sum(v["lane"] == 2 and 0 <= v["s_m"] <= LANE_2_M for v in t["vehicles"])
             for t in truth}
    ranked = sorted(count, key=count.get)
    few, many = ranked[:30], ranked[-30:]
    out = folder / "frames"
    out.mkdir()
    for at, name in enumerate(many + few):
        shutil.copy(frames / name, out / f"{at:04}.jpg")
    return out, [sum(map(count.get, names)) / len(names) for names in (few, many)]


def settings(folder, outputs, hold_s=HOLD_S):
    path = folder / "node.toml"
    text = f'site = "street"\nwindow_s = {WINDOW_S}\nhold_s = {hold_s}\n'
    for number, lane, on, off, fail_safe in outputs:
        text += (f"[[output]]\nnumber = {number}\nlane = {lane}\non_veh_km = {on}\n"
                 f'off_veh_km = {off}\nfail_safe = "{fail_safe}"\n')
    path.write_text(text)
    return str(path)


def daemon_config(folder, frames, device):
    path = folder / "verge.toml"
    path.write_text(f"""
site = "street"
[camera]
id = "curve"
source = "{frames}"
interval_s = 1.0
watch = false
[model]
file = "{ROOT}/models/verge_nanodet_640x480.toml"
[lane_table]
file = "{ROOT}/tests/data/curve.lut"
[windows]
lengths_s = [{WINDOW_S}]
[mqtt]
port = 1
[spool]
folder = "{folder}/spool"
[serial]
device = "{device}"
""")
    return path


class Daemon:
    def __init__(self, folder, config):
        self.log, self.config = open(folder / "daemon.log", "a"), config
        self.start()

    def start(self):
        self.process = subprocess.Popen(
            [VERGE, "run", "--config", str(self.config)], stdout=self.log, stderr=self.log)

    def end(self, how=signal.SIGKILL):
        self.process.send_signal(how)
        self.process.wait(20)


@check("settings are refused, accepted, kept over a reset, and read back")
def settings_are_kept(board, cable, folder, wanted):
    assert board.outputs() == 0xFF, "a node that lost its settings closes every output"
    bad = settings(folder, [(1, 2, 10.0, 20.0, "closed")])
    code, _, said = node(cable, "set", bad)
    assert code == 65 and "off_veh_km must be below" in said, said
    code, out, said = node(cable, "set", settings(folder, wanted))
    assert code == 0 and "written 1 times" in out, out + said
    board.ask("system_reset")
    code, again, said = node(cable, "settings")
    assert (code, again) == (0, out), again + said
    until("fail-safe after the reset", 5, lambda: board.outputs() == 0b101)


@check("a reset in the middle of writing settings leaves the old ones or the new ones")
def resets_while_writing(board, cable, folder, wanted):
    random_delays, seen = random.Random(2), set()
    for attempt in range(12):
        other = [(1, 2, 100.0 + attempt, 5.0, "open")]
        path = settings(folder, other)
        before = node(cable, "settings")[1]
        setting = subprocess.Popen([VERGE, "node", "--device", cable.device, "set", path],
                                   stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        time.sleep(random_delays.uniform(0.0, 0.08))
        board.ask("system_reset")
        setting.wait(30)
        after = node(cable, "settings")[1]
        new = f"on_veh_km = {100.0 + attempt}" in after
        assert new or after == before, f"{before}\n{after}"
        seen.add(new)
    code, _, said = node(cable, "set", settings(folder, wanted))
    assert code == 0, said
    return f"{'both' if len(seen) == 2 else 'one'} seen"


@check("outputs follow the daemon's density over and under the thresholds")
def outputs_follow(board, cable):
    for state in (True, False, True):
        until(f"output 1 {'closed' if state else 'open'}", 75,
              lambda: bool(board.outputs() & 1) == state and counters(cable)["messages"] > 0)
    assert board.outputs() & 0b1010 == 0, "outputs that are not set stay open"


@check("a cut cable leads to the fail-safe state within the hold time, and back")
def cut_cable(board, cable):
    until("output 1 open", 75, lambda: board.outputs() & 0b111 == 0b000)
    cable.cut = True
    took = until("fail-safe", 2 * HOLD_S + 5, lambda: board.outputs() & 0b111 == 0b101)
    cable.cut = False
    until("output 3 follows again", 4 * WINDOW_S, lambda: board.outputs() & 0b100 == 0)
    return f"{took:.0f} s"


@check("garbled frames lead to the fail-safe state, are counted, and it comes back")
def garbled(board, cable):
    until("output 3 open", 30, lambda: board.outputs() & 0b100 == 0)
    cable.garble = random.Random(3)
    until("fail-safe", 2 * HOLD_S + WINDOW_S + 5, lambda: board.outputs() & 0b100)
    cable.garble = None
    counted = counters(cable)
    assert counted["checksum"] + counted["framing"] + counted["overrun"] > 0, counted
    until("output 3 follows again", 4 * WINDOW_S, lambda: board.outputs() & 0b100 == 0)


@check("a killed daemon leads to the fail-safe state, a new one back")
def killed(board, cable, daemon):
    until("output 3 open", 30, lambda: board.outputs() & 0b100 == 0)
    daemon.end()
    until("fail-safe", 2 * HOLD_S + 5, lambda: board.outputs() & 0b111 == 0b101)
    daemon.start()
    until("output 3 follows again", 4 * WINDOW_S, lambda: board.outputs() & 0b100 == 0)


@check("the watchdog resets a core that hangs, and the node comes back")
def hung(board, cable):
    before = counters(cable)["restarts"]
    board.hang()
    until("a restart", 10, lambda: node(cable, "counters")[0] == 0)
    after = counters(cable)["restarts"]
    assert after == before + 1, f"{before} and {after}"


@check("from a message's last byte to the pins it takes under 5 ms")
def latency(board, cable):
    worst = counters(cable)["latency_max_us"]
    assert 0 < worst < 5000, f"{worst} us"
    return f"worst {worst / 1000:.1f} ms"


@check("the stack stays inside its part of memory.x")
def stack(board):
    start, length = STACK
    used = length - next(
        at for at, byte in enumerate(board.memory(start, length)) if byte != PAINT)
    assert used < STACK_LIMIT * length, f"{used} of {length} bytes"
    return f"{used} of {length} bytes"


def main():
    folder = pathlib.Path(tempfile.mkdtemp(prefix="verge-node-"))
    board = Qemu(folder)
    daemon = None
    try:
        board.ask("cont")
        cable = Cable(board.uart)
        frames, (few, many) = recording(folder)
        # Thresholds lie between the true densities of both kinds of picture.
        middle, per_vehicle = (few + many) / 2, 1000 / LANE_2_M
        on, off = (middle + 0.2) * per_vehicle, (middle - 0.2) * per_vehicle
        # Output 1 follows lane 2, fail-safe closed; 2 is not set; 3 closes only to be fail-safe.
        wanted = [(1, 2, round(on, 1), round(off, 1), "closed"), (3, 2, 450.0, 400.0, "closed")]
        settings_are_kept(board, cable, folder, wanted)
        resets_while_writing(board, cable, folder, wanted)
        daemon = Daemon(folder, daemon_config(folder, frames, cable.device))
        outputs_follow(board, cable)
        cut_cable(board, cable)
        garbled(board, cable)
        latency(board, cable)
        killed(board, cable, daemon)
        daemon.end(signal.SIGTERM)
        stack(board)
        hung(board, cable)
    except BaseException:
        sys.stderr.write((folder / "daemon.log").read_text()[-3000:]
                         if (folder / "daemon.log").exists() else "")
        raise
    finally:
        if daemon and daemon.process.poll() is None:
            daemon.end()
        board.stop()
        shutil.rmtree(folder, ignore_errors=True)
    print(f"the I/O node: {len(PASSED)} of {len(PASSED)} checks passed")


main()
