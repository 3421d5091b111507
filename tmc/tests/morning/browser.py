"""The morning page in Chromium: light, dark, 400 px wide, by keyboard, on paper.

    browser.py REPORT SERVED_URL [SHOTS]

REPORT is the folder of a report, SERVED_URL the page of `verge-tmc serve` over the same archive.
With SHOTS a picture of each view is kept there. Fails on a script error, a request to anywhere else,
text whose contrast is below WCAG's AA, a page wider than its window, or a link that the keyboard does
not reach.
"""

import pathlib
import shutil
import sys
from urllib.parse import urlsplit

from playwright.sync_api import sync_playwright

report, served = pathlib.Path(sys.argv[1]).resolve(), sys.argv[2]
shots = pathlib.Path(sys.argv[3]) if len(sys.argv) > 3 else None
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")

# Contrast of every text that is seen against what lies behind it (WCAG 2.1, 1.4.3).
CONTRAST = """() => {
  const parse = (text) => {
    const n = (text.match(/[\\d.]+/g) || []).map(Number);
    return n.length < 3 ? null : [n[0], n[1], n[2], n.length > 3 ? n[3] : 1];
  };
  const over = (a, b) => [0, 1, 2].map((i) => a[i] * a[3] + b[i] * (1 - a[3])).concat([1]);
  const light = (c) => {
    const s = [0, 1, 2].map((i) => c[i] / 255)
      .map((v) => (v <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4));
    return 0.2126 * s[0] + 0.7152 * s[1] + 0.0722 * s[2];
  };
  const behind = (element) => {
    const layers = [];
    for (let at = element; at; at = at.parentElement) {
      const colour = parse(getComputedStyle(at).backgroundColor);
      if (colour && colour[3] > 0) { layers.push(colour); if (colour[3] === 1) break; }
    }
    return layers.reverse().reduce((below, layer) => over(layer, below), [255, 255, 255, 1]);
  };
  const wrong = [];
  let tried = 0;
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const element = walker.currentNode.parentElement;
    const text = walker.currentNode.textContent.trim();
    if (!text || element.closest('.paper svg, title, style')) continue;
    const box = element.getBoundingClientRect();
    if (box.width === 0 || box.height === 0 || box.right < 0) continue;
    const style = getComputedStyle(element);
    const inSvg = element instanceof SVGElement;
    let ground = behind(element);
    const marker = inSvg && element.parentElement.querySelector('circle, rect');
    if (element.closest('a') && marker) ground = parse(getComputedStyle(marker).fill);
    const ink = over(parse(inSvg ? style.fill : style.color), ground);
    const [a, b] = [light(ink), light(ground)].sort((x, y) => y - x);
    const ratio = (a + 0.05) / (b + 0.05);
    const large = parseFloat(style.fontSize) >= 24
      || (parseFloat(style.fontSize) >= 18.66 && parseInt(style.fontWeight) >= 700);
    tried += 1;
    if (ratio < (large ? 3 : 4.5)) wrong.push(`${ratio.toFixed(2)} ${element.className.baseVal ?? element.className}: ${text.slice(0, 40)}`);
  }
  return [tried, wrong];
}"""

problems = []


def looked_at(page, name):
    tried, wrong = page.evaluate(CONTRAST)
    if tried < 20:
        problems.append(f"{name}: only {tried} texts")
    problems.extend(f"{name}: contrast {text}" for text in wrong[:5])
    wide, window = page.evaluate("() => [document.documentElement.scrollWidth, innerWidth]")
    if wide > window:
        problems.append(f"{name}: {wide} px wide in {window}")
    if shots:
        shots.mkdir(parents=True, exist_ok=True)
        page.screenshot(path=str(shots / f"{name}.png"), full_page=True)


def by_keyboard(page, name):
    """Every link is reached by Tab, in the order of the page, and is seen to have the focus."""
    links = page.evaluate("() => document.querySelectorAll('a[href]').length")
    reached = 0
    for _ in range(links + 5):
        page.keyboard.press("Tab")
        seen = page.evaluate(
            """() => { const a = document.activeElement;
            if (!a.matches('a[href]')) return null;
            const s = getComputedStyle(a);
            return (s.outlineStyle !== 'none' && parseFloat(s.outlineWidth) > 0) || !!a.closest('svg'); }"""
        )
        reached += seen is not None
        if seen is False:
            problems.append(f"{name}: a link's focus is not seen")
            break
    if reached < links:
        problems.append(f"{name}: Tab reaches {reached} of {links} links")
    page.reload()
    page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    if page.evaluate("() => document.activeElement.id") != "main":
        problems.append(f"{name}: the first link does not lead to the content")


with sync_playwright() as playwright:
    browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
    for source, address in [("report", (report / "index.html").as_uri()), ("served", served)]:
        own = urlsplit(address)
        for scheme in ["light", "dark"]:
            for width in [1280, 400]:
                context = browser.new_context(
                    viewport={"width": width, "height": 900}, color_scheme=scheme
                )
                page = context.new_page()
                name = f"{source}-{scheme}-{width}"
                page.on("pageerror", lambda e, n=name: problems.append(f"{n}: {e}"))
                page.on(
                    "console",
                    lambda m, n=name: m.type in ("error", "warning")
                    and problems.append(f"{n}: {m.text}"),
                )

                def requested(request, n=name):
                    to = urlsplit(request.url)
                    if to.scheme != "data" and (to.scheme, to.netloc) != (own.scheme, own.netloc):
                        problems.append(f"{n}: asks {request.url}")

                page.on("request", requested)
                page.goto(address)
                looked_at(page, name)
                if width == 1280 and scheme == "light":
                    by_keyboard(page, name)
                page.click("table a[href$='bridge/index.html']")
                page.wait_for_load_state()
                looked_at(page, f"{name}-site")
                page.click("nav a") if source == "report" else page.goto(address)
                if "Traffic density" not in page.title():
                    problems.append(f"{name}: the way back leads to {page.title()!r}")
                if scheme == "dark" and width == 1280:
                    page.emulate_media(media="print")
                    ground = page.evaluate("() => getComputedStyle(document.body).backgroundColor")
                    if ground != "rgb(255, 255, 255)":
                        problems.append(f"{name}: paper is {ground}")
                    looked_at(page, f"{name}-print")
                context.close()
    browser.close()

for problem in problems:
    print(problem, file=sys.stderr)
sys.exit(bool(problems))
