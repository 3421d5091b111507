"""The desk in a real browser, from a folder of pictures or a camera to an audited site, and the view.

    drive.py MVCALIB --verge VERGE [--shots DIR] [--page]

Chromium is that of Debian, driven by Playwright. Frames are those of the simulated street in
tests/data, whose camera is known. --shots keeps a picture of each step; --page takes the page's
files from the tree in place of the program's own, so that no build is needed to try a change.
"""

import argparse
import atexit
import http.server
import json
import math
import pathlib
import re
import shutil
import subprocess
import tempfile
import threading
import urllib.error
import urllib.request

from PIL import Image, ImageChops
from playwright.sync_api import sync_playwright

ROOT = pathlib.Path(__file__).resolve().parents[3]
STREET = ROOT / "tests/data/freeway"
PAGES = [ROOT / "calib/src/desk/page", ROOT / "desk/page", ROOT / "src/daemon/view/page"]
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
SIZE = {"width": 1366, "height": 650}
MOST_ACTIONS = 60


class Truth:
    """The street's camera and its lane lines."""

    def __init__(self):
        camera = json.loads((STREET / "calibration.json").read_text())
        self.f, self.k1 = camera["f"], camera["k1"]
        self.centre = camera["principal_point"]
        self.r, self.t = rotation(camera["rvec"]), camera["tvec"]
        self.lanes = []
        for shape in json.loads((STREET / "lanes.json").read_text())["shapes"]:
            points, half = shape["points"], len(shape["points"]) // 2
            self.lanes.append((points[:half], points[half:][::-1]))

    def ground(self, uv):
        x, y = ((p - c) / self.f for p, c in zip(uv, self.centre))
        dx, dy = x, y
        for _ in range(20):
            s = 1 + self.k1 * (dx * dx + dy * dy)
            dx, dy = x / s, y / s
        back = lambda v: [sum(self.r[i][k] * v[i] for i in range(3)) for k in range(3)]
        ray, centre = back([dx, dy, 1]), [-c for c in back(self.t)]
        reach = -centre[2] / ray[2]
        return [centre[0] + reach * ray[0], centre[1] + reach * ray[1]]

    def metres(self, a, b):
        return math.dist(self.ground(a), self.ground(b))


def rotation(rvec):
    angle = math.hypot(*rvec)
    x, y, z = (c / angle for c in rvec)
    s, c = math.sin(angle), math.cos(angle)
    d = 1 - c
    return [
        [c + x * x * d, x * y * d - z * s, x * z * d + y * s],
        [y * x * d + z * s, c + y * y * d, y * z * d - x * s],
        [z * x * d - y * s, z * y * d + x * s, c + z * z * d],
    ]


class Desk:
    """One program with one page; counts what a person would do."""

    def __init__(self, browser, command, page_files=None):
        self.process = subprocess.Popen(
            list(map(str, command)), stdout=subprocess.PIPE, text=True, cwd=ROOT
        )
        atexit.register(self.process.kill)
        self.address = self.process.stdout.readline().strip()
        self.context = browser.new_context(viewport=SIZE)
        self.page = self.context.new_page()
        self.foreign, self.faults, self.actions = [], [], 0
        self.page.on("request", self.requested)
        self.page.on("pageerror", lambda e: self.faults.append(str(e)))
        self.page.on("console", lambda m: m.type == "error" and "422" not in m.text and "404" not in m.text and self.faults.append(m.text))
        if page_files:
            types = {".js": "text/javascript", ".css": "text/css"}
            def own(route):
                name = route.request.url.rsplit("/", 1)[1]
                file = next(folder / name for folder in PAGES if (folder / name).exists())
                route.fulfill(body=file.read_text(), content_type=types[file.suffix])
            self.page.route("**/page/*", own)
        self.page.set_default_timeout(30000)
        self.page.goto(self.address, wait_until="commit")
        self.page.wait_for_selector("#busy[hidden], #collect", state="attached", timeout=60000)

    def requested(self, request):
        if not request.url.startswith((self.address, "data:", "blob:")):
            self.foreign.append(request.url)

    def close(self):
        self.context.close()
        self.process.terminate()
        self.process.wait()
        assert not self.foreign, f"requests that leave the page: {self.foreign}"
        assert not self.faults, f"faults in the page: {self.faults}"

    def calm(self):
        self.page.wait_for_timeout(60)
        self.page.wait_for_selector("body[data-calm='true']", timeout=60000)

    def screen(self, uv):
        box = self.page.locator("#canvas").bounding_box()
        scale = min(box["width"] / 720, box["height"] / 480)
        x0 = box["x"] + (box["width"] - 720 * scale) / 2
        y0 = box["y"] + (box["height"] - 480 * scale) / 2
        return x0 + uv[0] * scale, y0 + uv[1] * scale

    def at(self, uv):
        self.actions += 1
        self.page.mouse.click(*self.screen(uv))

    def key(self, key):
        self.actions += 1
        self.page.keyboard.press(key)

    def type(self, text):
        self.actions += 1
        self.page.keyboard.type(text)

    def click(self, selector):
        self.actions += 1
        self.page.click(selector)

    def text(self, selector):
        return self.page.inner_text(selector)


def until(desk, condition, limit_s=120):
    """Waits for what the page shows. Playwright's own way evaluates text, which the page forbids."""
    for _ in range(10 * limit_s):
        if condition():
            return
        desk.page.wait_for_timeout(100)
    raise AssertionError(f"not within {limit_s} s: {desk.text('#panel')}")


def add_length(desk, a, b, metres):
    desk.at(a)
    desk.at(b)
    desk.type(f"{metres:.2f}")
    desk.key("Enter")


def from_pictures_to_a_table(desk, truth, shot):
    """The whole way, with wrong clicks on it."""
    shot("1-pictures")
    desk.click("#next")
    right, left = truth.lanes[0][0], truth.lanes[2][1]
    # Near and far along the road, near and far across it.
    add_length(desk, right[1], right[3], truth.metres(right[1], right[3]))
    add_length(desk, left[10], left[14], truth.metres(left[10], left[14]))
    add_length(desk, right[2], left[2], truth.metres(right[2], left[2]))
    desk.calm()
    shot("2-lengths")
    # A slip of the hand: a point beside the road, taken back.
    desk.at([60, 200])
    desk.key("Control+z")
    desk.key("n")
    for line in (truth.lanes[0][0], truth.lanes[0][1], truth.lanes[1][1], truth.lanes[2][1]):
        for k in (1, 3, 8, 13):
            desk.at(line[k])
        desk.key("Enter")
    desk.calm()
    desk.page.mouse.move(*desk.screen(right[5]))
    shot("3-road")
    assert "±" in desk.text("#camera-card")
    assert "card good" in desk.page.get_attribute("#camera-card", "class"), desk.text("#camera-card")
    desk.click("#next")
    desk.click("#all-lanes")
    desk.calm()
    # Lanes without a direction are red, and nothing can be saved.
    problems = desk.page.locator(".problem")
    assert problems.count() == 3 and "which way" in problems.first.inner_text()
    shot("4-undirected")
    desk.click("#all-away")
    desk.calm()
    assert problems.count() == 0, problems.all_inner_texts()
    shot("5-lanes")
    desk.click("#step-5")
    desk.click("#save")
    desk.page.wait_for_selector("#saved, #save-problem", timeout=60000)
    shot("6-saved")
    assert desk.page.locator("#saved").count() == 1, desk.text("#save-problem")
    actions = desk.actions
    assert actions < MOST_ACTIONS, f"{actions} actions, at most {MOST_ACTIONS} are allowed"
    return actions


def slips_do_no_harm(desk, truth):
    """Each of these lost something without a word, or stopped the page."""
    desk.click("#step-2")
    lengths = desk.page.locator("#lengths .item")
    before = lengths.count()
    # An undo takes the vehicle whose next point was to be set.
    desk.key("k")
    desk.at([300, 300])
    desk.key("Control+z")
    desk.at([310, 310])
    desk.key("Control+z")
    # A length begins where another ends.
    desk.key("l")
    desk.at(truth.lanes[0][0][2])
    desk.at(truth.lanes[1][0][5])
    desk.type("9,5m")
    desk.key("Enter")
    desk.calm()
    assert lengths.count() == before + 1
    assert desk.page.locator("[aria-label='Length 4 in m']").input_value() in ("9,5m", "9.5")
    desk.key("Control+z")
    desk.key("Control+z")
    desk.calm()
    assert lengths.count() == before
    # A wrong number stays, and is named.
    height = "[data-key='camera height']"
    desk.page.fill(height, "-5")
    desk.click("#step-5")
    desk.click("#save")
    desk.page.wait_for_selector("#save-problem")
    assert "Height of the camera is “-5”" in desk.text("#save-problem"), desk.text("#save-problem")
    desk.click("#step-2")
    assert desk.page.input_value(height) == "-5"
    desk.page.fill(height, "")
    desk.calm()
    # A half-drawn line is finished by going on.
    desk.click("[data-tool='Lane line']")
    desk.at([100, 300])
    desk.at([140, 240])
    desk.click("#step-3")
    assert "Finished" in desk.text("#hint"), desk.text("#hint")
    desk.key("Control+z")
    desk.calm()


def an_edit_while_it_is_saved_is_not_saved(desk):
    held = []
    desk.page.route("**/api/save/*", lambda route: held.append(route))
    desk.click("#save")
    until(desk, lambda: held)
    desk.page.fill("#site", "other")
    held[0].continue_()
    until(desk, lambda: "changed since" in desk.text("#panel"))
    desk.page.unroute("**/api/save/*")
    desk.key("Control+z")
    until(desk, lambda: "changed since" not in desk.text("#panel"))


def lane(desk, polygon):
    desk.key("p")
    for p in polygon:
        desk.at(p)
    desk.key("Enter")
    desk.calm()


def wrong_lanes_are_red(desk, truth, shot):
    """Each of these gave a wrong number without a word."""
    remove = lambda number: desk.page.locator(f"[aria-label='remove lane {number}']").click()
    desk.click("#step-3")
    # What is left is the lane furthest to the left.
    remove(3)
    remove(2)
    (right, _), (_, left) = truth.lanes[0], truth.lanes[1]
    # Over two lanes.
    lane(desk, [right[1], right[7], left[7], left[1]])
    desk.key("a")
    desk.calm()
    problem = desk.text(".problem")
    assert "covers two lanes" in problem, problem
    shot("7-two-lanes")
    desk.click("#step-5")
    desk.click("#save")
    desk.page.wait_for_selector("#save-problem")
    assert "two lanes" in desk.text("#save-problem")
    desk.click("#step-3")
    remove(2)
    # Over the lane that is there.
    right, left = truth.lanes[1][0], truth.lanes[1][1]
    beyond = [[(2 * p[0] + q[0]) / 3, (2 * p[1] + q[1]) / 3] for p, q in zip(left, truth.lanes[2][1])]
    lane(desk, [right[1], right[7], beyond[7], beyond[1]])
    desk.key("a")
    desk.calm()
    assert "overlaps lane" in desk.text("#lanes-problem"), desk.text("#panel")
    remove(2)
    # Further than is seen.
    right, left = truth.lanes[0]
    lane(desk, [right[1], [452, 100], [440, 100], left[1]])
    desk.key("a")
    desk.calm()
    assert "end it nearer" in desk.text(".problem"), desk.text(".problem")
    remove(2)


def true_boxes(path):
    """The street's own boxes as a detector would write them."""
    with path.open("w") as out:
        for line in (STREET / "truth.jsonl").read_text().splitlines():
            frame = json.loads(line)
            boxes = [[*v["box"], 0.9, v["class"]] for v in frame["vehicles"] if v.get("box")]
            out.write(json.dumps({"frame": frame["frame"], "boxes": boxes}) + "\n")


def move_pictures(folder):
    """Some of the street's pictures, 6 px to the right and 4 px down."""
    folder.mkdir()
    for path in sorted((STREET / "frames").iterdir())[::4]:
        image = Image.open(path)
        ImageChops.offset(image, 6, 4).save(folder / path.name, quality=92)


def the_traffic_is_counted(desk, shot):
    desk.click("#step-4")
    desk.page.wait_for_selector("#counts")
    # The first picture is on its way, and the table is drawn once more when it is there.
    until(desk, lambda: ".jpg" in desk.text("#backdrops"))
    desk.page.wait_for_timeout(500)
    rows = desk.page.locator("#counts tr").all_inner_texts()[1:]
    assert len(rows) == 3, rows
    # Columns: lane, now, mean, veh/km. Of a busy freeway 46 m hold a vehicle or so.
    means = [float(row.split()[-2]) for row in rows]
    assert all(0.2 < mean < 4 for mean in means), rows
    before = desk.text("#backdrops")
    desk.key("p")
    desk.page.wait_for_timeout(1400)
    desk.key("p")
    assert desk.text("#backdrops") != before, "the pictures do not play"
    shot("9-traffic")


def a_wrong_length_is_named(desk, truth, shot):
    desk.click("#step-2")
    field = desk.page.locator("[data-key='length-0']")
    right = field.input_value()
    field.fill(str(2 * float(right)))
    desk.calm()
    card = desk.text("#camera-card")
    assert "mark" in card and ("look at its" in card), card
    shot("8-contradiction")
    assert desk.page.locator("#lengths .item.bad").count() >= 1
    field.fill(right)
    desk.calm()
    assert "good" in desk.page.get_attribute("#camera-card", "class")


def dashes_are_found(desk, shot):
    """Along the drawn lines, in the picture without traffic; the road's edge is solid."""
    desk.click("#step-2")
    lengths = desk.page.locator("#lengths .item")
    before = lengths.count()
    desk.page.select_option("#dash-standard", label="metres typed later")
    desk.click("#find-dashes")
    said = desk.page.locator(".dashes")
    until(desk, lambda: said.count() > 0 and "…" not in said.all_inner_texts())
    desk.calm()
    shot("13-dashes")
    said = said.all_inner_texts()
    pitches = [float(m[1]) for m in (re.search(r"dashes, ([0-9.]+) m from one", t) for t in said) if m]
    # 12 ft and 36 ft.
    assert pitches and all(abs(p / 14.64 - 1) < 0.1 for p in pitches), said
    assert any("solid" in t for t in said), said
    assert lengths.count() == before + len(pitches), said
    # One undo takes them all back.
    desk.key("Control+z")
    desk.calm()
    assert lengths.count() == before


class Camera:
    """A camera that answers each request with the street's next picture."""

    def __init__(self):
        pictures = sorted((STREET / "frames").iterdir())
        asked = iter(range(10**9))

        class Answer(http.server.BaseHTTPRequestHandler):
            def do_GET(self):
                body = pictures[next(asked) % len(pictures)].read_bytes()
                self.send_response(200)
                self.send_header("Content-Type", "image/jpeg")
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *_):
                pass

        self.server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Answer)
        self.address = f"http://127.0.0.1:{self.server.server_port}/picture.jpg?key=secret"
        threading.Thread(target=self.server.serve_forever, daemon=True).start()


def pictures_come_from_a_camera(open_desk, folder, verge, shot):
    """A camera that is away is red; one that answers is collected from, as long as wanted."""
    asked = lambda address, name: open_desk(
        folder / name, "--camera", address, "--verge", verge, site=folder / name / "site")
    desk = asked("http://127.0.0.1:9/picture.jpg", "away")
    desk.click("#collect")
    desk.page.wait_for_selector("#collect-problem")
    assert "is the camera on" in desk.text("#collect-problem"), desk.text("#collect-problem")
    shot(desk, "12-camera-away")
    desk.close()
    desk = asked(Camera().address, "camera")
    desk.page.select_option("#interval", "1")
    desk.page.select_option("#for", "60")
    shot(desk, "13-camera")
    desk.click("#collect")
    desk.page.wait_for_selector("#live:not([hidden])", timeout=60000)
    # Seven and more make a picture without traffic.
    until(desk, lambda: int(desk.text("#enough").rsplit(" ", 1)[1]) >= 8)
    shot(desk, "14-collecting")
    assert "secret" not in desk.text("#panel"), "a query may hold a password"
    desk.click("#enough")
    desk.page.wait_for_selector("#next", timeout=60000)
    shot(desk, "15-collected")
    assert "pictures of 720 × 480" in desk.text("#panel"), desk.text("#panel")
    desk.close()


def inside(p, polygon):
    odd = False
    for (x0, y0), (x1, y1) in zip(polygon, polygon[1:] + polygon[:1]):
        if (y0 > p[1]) != (y1 > p[1]) and p[0] < x0 + (p[1] - y0) / (y1 - y0) * (x1 - x0):
            odd = not odd
    return odd


def counted_by_eye(site):
    """Vehicles by picture and lane, as a person with good eyes counts them in the saved lanes."""
    shapes = json.loads((site / "lanes.json").read_text())["shapes"]
    counts = {}
    for line in (STREET / "truth.jsonl").read_text().splitlines():
        frame = json.loads(line)
        boxes = [v["box"] for v in frame["vehicles"] if v.get("box")]
        feet = [((b[0] + b[2]) / 2, b[3]) for b in boxes if b[3] < 479]
        counts[frame["frame"]] = [sum(inside(p, s["points"]) for p in feet) for s in shapes]
    return counts


def the_site_is_audited(desk, site, shot):
    """Counts ten pictures, one of them wrongly at first."""
    truth = counted_by_eye(site)
    desk.click("#step-6")
    desk.page.wait_for_selector("#choose")
    shot("16-audit")
    desk.click("#choose")
    desk.page.wait_for_selector("#count-0", timeout=240000)
    shown = lambda: desk.page.inner_text("#backdrops .name >> nth=0")
    pictures = desk.page.locator(".dots .dot").count()
    assert pictures == 10, pictures
    for k in range(pictures):
        until(desk, lambda: f"picture {k + 1} of" in desk.text("#panel").lower())
        fields = [desk.page.input_value(f"#count-{lane}") for lane in range(3)]
        assert fields == ["", "", ""], f"picture {k + 1} begins with {fields}"
        counts = list(truth[shown()])
        if k == 3:
            wrong, right, counts[0] = shown(), counts[0], 60
        for count in counts:
            desk.page.keyboard.type(str(count))
            desk.key("Enter")
        if k == 4:
            shot("17-counting")
    desk.click("#compare")
    desk.page.wait_for_selector("#audit-problem", timeout=240000)
    problem = desk.text("#audit-problem")
    assert wrong in problem and "count it again" in problem, problem
    assert desk.page.locator(".dots .dot.bad").count() == 1 and shown() == wrong
    assert not (site / "audit.toml").exists(), "a contradiction was written"
    shot("18-contradiction")
    desk.page.fill("#count-0", str(right))
    desk.click("#compare")
    desk.page.wait_for_selector("#audited", timeout=240000)
    shot("19-audited")
    assert desk.page.locator("#audit-frames tr").count() == pictures + 1
    assert 'audit = "audit.toml"' in (site / "verge.toml").read_text()
    assert (site / "audit.toml").read_text().startswith("# Made by")


def the_view_shows_and_changes_nothing(view, shot):
    view.page.wait_for_selector("#counts", timeout=120000)
    view.page.wait_for_timeout(600)
    rows = view.page.locator("#counts tr").all_inner_texts()[1:]
    assert len(rows) == 3 and rows[0].startswith("●"), rows
    assert "stands where the lanes were drawn" in view.text("#health") or "not yet" in view.text("#health")
    # The middle of a run of a lane's pixels, where the page has it on the screen.
    view.page.evaluate("""async () => {
      const { runs } = await (await fetch("api/lanes")).json();
      const [, v, from, to] = runs[runs.length >> 1];
      const canvas = document.getElementById("canvas"), box = canvas.getBoundingClientRect();
      const [w, h] = [box.width, box.height], image = new Image();
      image.src = "api/picture.jpg";
      await image.decode();
      const scale = Math.min(w / image.naturalWidth, h / image.naturalHeight);
      const x = (w - scale * image.naturalWidth) / 2 + scale * (from + to + 1) / 2;
      const y = (h - scale * image.naturalHeight) / 2 + scale * (v + 0.5);
      const at = { clientX: box.left + x, clientY: box.top + y, bubbles: true };
      canvas.dispatchEvent(new PointerEvent("pointermove", at));
    }""")
    assert re.match(r"lane \d, \d+\.\d m from", view.text("#place")), view.text("#place")
    shot("20-view")
    bare = "/".join(view.address.split("/")[:3]) + "/"
    for address, data, expected in ((view.address + "api/seen", b"{}", 405), (bare + "api/seen", None, 403)):
        request = urllib.request.Request(address, data=data, headers={"Content-Type": "application/json"})
        try:
            status = urllib.request.urlopen(request).status
        except urllib.error.HTTPError as refused:
            status = refused.code
        assert status == expected, f"{address}: {status}"


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("mvcalib")
    parser.add_argument("--verge", required=True)
    parser.add_argument("--shots", type=pathlib.Path)
    parser.add_argument("--page", action="store_true")
    arguments = parser.parse_args()
    mvcalib, verge = (pathlib.Path(p).resolve() for p in (arguments.mvcalib, arguments.verge))
    truth = Truth()
    with sync_playwright() as playwright, tempfile.TemporaryDirectory() as folder:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        folder = pathlib.Path(folder)
        site = folder / "bridge"

        def open_desk(frames, *more, site=site):
            desk = Desk(browser, [mvcalib, "desk", frames, "--site", site, *more], arguments.page)
            if "--camera" not in more:
                desk.calm()
            return desk

        def take(desk, name):
            if arguments.shots:
                arguments.shots.mkdir(parents=True, exist_ok=True)
                desk.page.wait_for_timeout(150)
                desk.page.screenshot(path=arguments.shots / f"{name}.png")

        desk = open_desk(STREET)
        shot = lambda name: take(desk, name)
        actions = from_pictures_to_a_table(desk, truth, shot)
        files = sorted(f.name for f in site.iterdir())
        for wanted in ("calibration.json", "lanes.json", "lanes.lut", "verge.toml", "site.json", "pose.png"):
            assert wanted in files, files
        saved = {f.name: f.read_bytes() for f in site.iterdir()}
        lengths = json.loads(saved["lanes.json"])["shapes"]
        assert [s["label"] for s in lengths] == ["1", "2", "3"]
        slips_do_no_harm(desk, truth)
        dashes_are_found(desk, shot)
        a_wrong_length_is_named(desk, truth, shot)
        wrong_lanes_are_red(desk, truth, shot)
        now = {f.name: f.read_bytes() for f in site.iterdir() if f.name != "draft.json"}
        assert saved == now, "a refusal wrote a file"
        desk.close()
        print(f"from a folder of frames to a saved table: {actions} actions")

        # A saved site opens again, and counts what a detector found.
        boxes = folder / "boxes.jsonl"
        true_boxes(boxes)
        desk = open_desk(STREET, "--detections", boxes)
        # What was tried since is there, until it is dropped.
        desk.page.wait_for_selector("#draft")
        shot("08-draft")
        desk.click("#drop-draft")
        desk.page.wait_for_selector("#draft", state="detached")
        desk.page.wait_for_selector("#camera-card.good")
        assert desk.page.locator("#moved").count() == 0
        the_traffic_is_counted(desk, shot)
        desk.close()

        # Ten of some pictures are counted by eye.
        some = folder / "some"
        some.mkdir()
        for path in sorted((STREET / "frames").iterdir())[::4]:
            shutil.copy(path, some)
        # What was drawn on others and not saved is kept, and the page says where.
        draft = json.loads((site / "site.json").read_text()) | {"backdrop": "00"}
        (site / "draft.json").write_text(json.dumps(draft))
        desk = open_desk(some, "--verge", verge)
        desk.page.wait_for_selector("#aside")
        assert "draft-1.json" in desk.text("#aside"), desk.text("#aside")
        assert json.loads((site / "draft-1.json").read_text()) == draft
        the_site_is_audited(desk, site, shot)
        desk.close()
        print("the site is audited")

        view = Desk(browser, [verge, "view", "--config", site / "verge.toml"])
        the_view_shows_and_changes_nothing(view, lambda name: take(view, name))
        view.close()
        print("the view shows what the sensor sees")

        pictures_come_from_a_camera(open_desk, folder, verge, take)
        print("pictures come from a camera")

        # The camera has moved: a look and a click, then it is saved; undone, it is asked again.
        moved = folder / "moved"
        move_pictures(moved)
        desk = open_desk(moved)
        desk.page.wait_for_selector("#moved")
        shot("10-moved")
        desk.click("#step-5")
        desk.click("#save")
        desk.page.wait_for_selector("#save-problem")
        assert "look at the points" in desk.text("#save-problem")
        desk.click("#confirm-moved")
        desk.calm()
        assert desk.page.locator("#moved").count() == 0
        desk.key("Control+z")
        desk.page.wait_for_selector("#moved")
        desk.key("Control+y")
        desk.calm()
        desk.click("#save")
        desk.page.wait_for_selector("#saved")
        an_edit_while_it_is_saved_is_not_saved(desk)
        # Other lanes, another table: the audit does not hold for it.
        assert 'audit = ' not in (site / "verge.toml").read_text()
        desk.close()
        browser.close()
    print("the desk in a browser: all is well")


if __name__ == "__main__":
    main()
