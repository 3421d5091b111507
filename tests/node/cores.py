"""Runs the counting core and the eye core in QEMU on real input and measures their stack.

Input and output lie in the board's PSRAM, as rings that another processor would fill and empty.
The pictures are decoded with Pillow; without it the eye is left out, loudly.
"""

import json
import os
import pathlib
import socket
import struct
import subprocess
import sys
import tempfile
import time

BUILT = pathlib.Path(sys.argv[1])
ROOT = pathlib.Path(__file__).resolve().parents[2]
DATA = ROOT / "tests/data"
STACK_AT = 0x20000000
# How far a stack may grow of what memory.x gives it.
STACK_LIMIT = 0.75
PAINT = 0xA5
# 2026-01-05T08:00:00Z, when a window begins.
START_MS = 1767600000000
WIDTH, HEIGHT = 320, 240


def run(program, memory, done, stack):
    """Runs `program` with `memory` at its addresses until `done` of what it wrote; returns that
    and the stack it took, bytes. `done` gets a function that reads memory."""
    with tempfile.TemporaryDirectory(prefix="verge-core-") as folder:
        folder = pathlib.Path(folder)
        loads = []
        for address, content in [*memory.items(), (STACK_AT, bytes([PAINT]) * stack)]:
            (folder / f"{address:x}").write_bytes(content)
            loads += ["-device", f"loader,addr={address},file={folder / f'{address:x}'},force-raw=on"]
        process = subprocess.Popen(
            ["qemu-system-arm", "-M", "mps2-an386", "-accel", "tcg", "-display", "none",
             "-monitor", "none", "-serial", "none", "-kernel", BUILT / program, *loads,
             "-qmp", f"unix:{folder / 'qmp'},server=on,wait=off"])
        try:
            qmp = connect(folder / "qmp")

            def ask(command, **arguments):
                qmp.write(json.dumps({"execute": command, "arguments": arguments}) + "\n")
                qmp.flush()
                while "return" not in (answer := json.loads(qmp.readline())):
                    assert "error" not in answer, answer

            def read(address, length):
                ask("pmemsave", val=address, size=length, filename=str(folder / "read"))
                return (folder / "read").read_bytes()

            qmp.readline()
            ask("qmp_capabilities")
            ends = time.monotonic() + 60
            while (result := done(read)) is None:
                assert time.monotonic() < ends, f"{program}: nothing in 60 s"
                time.sleep(0.1)
            painted = read(STACK_AT, stack)
        finally:
            process.kill()
            process.wait()
    used = stack - next(at for at, byte in enumerate(painted) if byte != PAINT)
    assert used < STACK_LIMIT * stack, f"{program}: a stack of {used} of {stack} bytes"
    return result, f"stack {used} of {stack} bytes"


def connect(path):
    for _ in range(100):
        line = socket.socket(socket.AF_UNIX)
        try:
            line.connect(str(path))
            return line.makefile("rw")
        except OSError:
            time.sleep(0.1)
    raise RuntimeError(f"{path}: QEMU does not answer")


def table(name):
    content = (DATA / name).read_bytes()
    return struct.pack("<I", len(content)) + content


def counting():
    """Two minutes of a full picture: two windows."""
    points = [(4 + 20 * (n % 16), 60 + 30 * (n // 16)) for n in range(96)]
    contacts = b"".join(struct.pack("<2f", *point) for point in points)
    frames = [struct.pack("<qII", START_MS + 1000 * n, 1000 * n, 96) + contacts + bytes([1] * 96)
              for n in range(125)]
    inbox = struct.pack("<Ixxxx", len(frames)) + b"".join(frames)

    def done(read):
        written, length = struct.unpack("<2I", read(0x21100000, 8))
        return read(0x21100008, length) if written == 2 else None

    message, stack = run("counting_core", {0x21000000: inbox, 0x21200000: table("curve.lut")},
                         done, 40 << 10)
    assert b"curve" in message, message
    return f"2 windows, the second in {len(message)} bytes, {stack}"


def eye():
    """The street, the same again, swayed, swayed by three columns, and a black picture."""
    from PIL import Image, ImageChops
    names = sorted((DATA / "curve/frames").iterdir())
    first, second = (Image.open(names[n]).convert("RGB") for n in (0, 4))
    assert first.size == (WIDTH, HEIGHT), first.size
    pictures = [(0, first), (1000, first), (6000, second), (12000, ImageChops.offset(first, 3, 0)),
                (18000, Image.new("RGB", first.size))]
    each = 3 * WIDTH * HEIGHT
    entries = b"".join(
        struct.pack("<2I", since, 0x21010000 + n * each) for n, (since, _) in enumerate(pictures))
    inbox = struct.pack("<I", len(pictures)) + entries
    rgb = b"".join(picture.tobytes() for _, picture in pictures)

    def done(read):
        content = read(0x21900000, 4 + 12 * len(pictures))
        verdicts = list(struct.iter_unpack("<I2f", content[4:]))
        return verdicts if struct.unpack_from("<I", content)[0] == len(pictures) else None

    verdicts, stack = run(
        "eye_core", {0x21000000: inbox, 0x21010000: rgb, 0x21A00000: table("curve.lut")}, done,
        128 << 10)
    kinds = [kind for kind, _, _ in verdicts]
    # 18: blank, the third of the alarms.
    assert kinds == [0, 1, 0, 0, 18], verdicts
    assert all(abs(u) < 1 and abs(v) < 1 for _, u, v in (verdicts[0], verdicts[2])), verdicts
    assert abs(abs(verdicts[3][1]) - 3) < 0.5 and abs(verdicts[3][2]) < 0.5, verdicts
    return f"5 pictures, shifted by {verdicts[3][1]:.2f} px of 3, {stack}"


def main():
    print(f"ok    the counting core counts: {counting()}", flush=True)
    try:
        import PIL  # noqa: F401
    except ImportError:
        if os.environ.get("VERGE_NO_SKIP") == "1":
            raise
        print("!!!! NOT RUN: the eye core (no Pillow: pip install pillow) !!!!", flush=True)
        return
    print(f"ok    the eye core sees: {eye()}", flush=True)


main()
