"""The page of a run of gld sample in Chromium: file://, no network, software WebGL.

report_page_test.py WRITE_DRAWN_RUN WRITE_RESULT_PAGES SCRATCH

WRITE_DRAWN_RUN (tests/support/write_drawn_run.cpp) makes run folders of a drawn room with true depth, WRITE_RESULT_PAGES (beside it) pages
of a training, an evaluation and an ablation of the tree. Debian's chromium,
chromium-driver and python3-selenium are what it needs (scripts/setup.sh --testing).
"""

import base64
import collections
import json
import pathlib
import shutil
import subprocess
import sys
import time

from selenium import webdriver
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys

HOSTILE = "</script><img src=x onerror=window.hostile=1>"
# Seconds that a page may take for anything: a renderer in software beside other work draws a picture of Gaussians in some.
PATIENCE = 150
LEAST_PSNR = 22.0
LEAST_COVERED = 0.7

# In the page: draws two pictures at width x height and compares them where `shown` covers: dB, and the share that is covered.
COMPARE = """
async function pixels(address, width, height, crop) {
  const image = new Image();
  image.src = address;
  await image.decode();
  const canvas = document.createElement('canvas');
  canvas.width = width;
  canvas.height = height;
  const context = canvas.getContext('2d');
  context.imageSmoothingQuality = 'high';
  const from = crop || [0, 0, image.width, image.height];
  context.drawImage(image, ...from, 0, 0, width, height);
  return context.getImageData(0, 0, width, height).data;
}
async function compare(shown, photograph, width, height, crop) {
  const a = await pixels(shown, width, height, crop), b = await pixels(photograph, width, height);
  let covered = 0, sum = 0;
  for (let i = 0; i < a.length; i += 4) {
    if (a[i + 3] < 128) continue;
    ++covered;
    for (let c = 0; c < 3; ++c) sum += (a[i + c] - b[i + c]) ** 2;
  }
  return {psnr: -10 * Math.log10(Math.max(sum / covered / 3, 1e-9) / 65025), covered: covered / (a.length / 4)};
}
"""

def check(holds, what):
    if not holds:
        raise AssertionError(what)


def png_address(file):
    return "data:image/png;base64," + base64.b64encode(pathlib.Path(file).read_bytes()).decode()


class Browser:
    def __init__(self, *flags):
        options = webdriver.ChromeOptions()
        for flag in ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--window-size=900,700", "--hide-scrollbars", *flags):
            options.add_argument(flag)
        options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
        self.driver = webdriver.Chrome(options=options)
        self.driver.set_script_timeout(60)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.driver.quit()

    def open(self, file):
        self.logs()
        self.file = pathlib.Path(file).resolve().as_uri()
        self.driver.get(self.file)
        self.wait("return window.gldPage && gldPage.ready")

    def run(self, script, *arguments):
        return self.driver.execute_script(script, *arguments)

    def run_async(self, script, *arguments):
        answer = self.driver.execute_async_script(
            COMPARE + "const done = arguments[arguments.length - 1]; (async () => {" + script + "})().then(done, (error) => done({error: String(error)}));",
            *arguments)
        check(not (isinstance(answer, dict) and "error" in answer), f"expected a script that runs, found {answer}")
        return answer

    def wait(self, script, seconds=PATIENCE):
        end = time.monotonic() + seconds
        while not self.run(script):
            check(time.monotonic() < end, f"expected within {seconds} s: {script}")
            time.sleep(0.05)

    def logs(self):
        return [self.driver.get_log(kind) for kind in ("browser", "performance")]

    def check_silence(self):
        """No message on the console, and one request: the page's own file."""
        console, network = self.logs()
        check(console == [], f"expected nothing on the console, found {console}")
        asked = []
        for entry in network:
            message = json.loads(entry["message"])["message"]
            if message["method"] == "Network.requestWillBeSent":
                asked.append(message["params"]["request"]["url"])
        others = [address for address in asked if not address.startswith("data:") and address != self.file]
        check(others == [], f"expected no request, found {others}")
        check(self.file in asked, "expected the log to show the page's own request")

    def settle(self):
        """Until nothing flies or swings any more."""
        self.wait("return gldPage.viewer.settled")
        end = time.monotonic() + PATIENCE
        before = None
        while (picture := self.drawn_picture()) != before:
            check(time.monotonic() < end, f"expected a scene that comes to rest within {PATIENCE} s")
            before = picture

    def drawn_picture(self):
        self.run("gldPage.viewer.draw(gldPage.viewer.currentPose(performance.now()))")
        return self.picture()

    def covered(self):
        """The share of the scene's picture where something is."""
        return self.run_async("""
            const {canvas} = gldPage.viewer, colours = await pixels(canvas.toDataURL(), canvas.width, canvas.height);
            let count = 0;
            for (let i = 3; i < colours.length; i += 4) count += colours[i] >= 128;
            return 4 * count / colours.length;""")

    def set_slider(self, name, value):
        self.run("const s = document.getElementById(arguments[0]); s.value = arguments[1]; s.dispatchEvent(new Event('input'));", name, value)

    def picture(self):
        return self.run("return gldPage.viewer.canvas.toDataURL()")

    def wait_for_other_picture(self, picture, after="a key"):
        end = time.monotonic() + 20
        while self.picture() == picture:
            if time.monotonic() > end:
                lost = self.run("return gldPage.viewer.renderer.getContext().isContextLost()")
                raise AssertionError(f"expected another picture of the scene within 20 s of {after}; context lost: {lost}, log: {self.logs()[0]}")
            time.sleep(0.05)

    def wait_for_picture(self, picture, after):
        end = time.monotonic() + 20
        while self.picture() != picture:
            check(time.monotonic() < end, f"expected the picture of before within 20 s of {after}")
            time.sleep(0.05)


def data_of(html):
    start = html.index('id="data">') + len('id="data">')
    return json.loads(html[start:html.index("</script>", start)])


def with_changed_data(file, other, change):
    html = file.read_text()
    data = data_of(html)
    old = html[html.index('id="data">') + len('id="data">'):]
    old = old[:old.index("</script>")]
    change(data)
    other.write_text(html.replace(old, json.dumps(data).replace("<", "\\u003c")))


def at_sources(browser, run, most=None):
    """Of each source camera, or of so many, how the canvas compares with its photograph."""
    browser.run("""
        for (const kind of ['source', 'generated']) {
          const box = document.getElementById(`show-${kind}`);
          if (box.checked) box.click();
        }""")
    browser.set_slider("fade", 0)
    views = browser.run("return page.views.map((view) => [view.role, view.file, view.width, view.height])")
    found = []
    for index, (role, file, width, height) in enumerate(views):
        if role != "source" or len(found) == most:
            continue
        browser.run("gldPage.viewer.goTo(arguments[0])", index)
        browser.settle()
        found.append(browser.run_async("""
            const [index, photograph, width, height] = arguments;
            const {viewer} = gldPage;
            const ratio = viewer.renderer.getPixelRatio(), size = viewer.size;
            const place = pictureRectangle(viewer.views[index], size.width, size.height);
            const crop = [place.left, place.top, place.width, place.height].map((x) => x * ratio);
            return compare(viewer.canvas.toDataURL(), photograph, width, height, crop);""",
            index, png_address(run / file), width, height))
    return found


def equals(found):
    return all(one["psnr"] >= LEAST_PSNR and one["covered"] >= LEAST_COVERED for one in found)


def mirror(data):
    data["cloud"]["low"][0] *= -1
    data["cloud"]["step"][0] *= -1


def swap_focal_lengths(data):
    for view in data["views"]:
        view["fx"], view["fy"] = view["fy"], view["fx"]


def centre(data):
    for view in data["views"]:
        view["cx"], view["cy"] = view["width"] / 2, view["height"] / 2


def check_noticed(browser, run, changes):
    """A page that is wrong in one of these ways does not pass."""
    for change in changes:
        wrong = run / f"{change.__name__}.html"
        with_changed_data(run / "report.html", wrong, change)
        browser.open(wrong)
        found = at_sources(browser, run, most=1)
        print(f"  with {change.__name__}:", ", ".join(f"{one['psnr']:.1f} dB of {one['covered']:.0%}" for one in found))
        check(not equals(found), f"expected {change.__name__} to be noticed, found {found}")


def test_cameras(browser, run, odd):
    browser.open(run / "report.html")
    found = at_sources(browser, run)
    print("at the source cameras:", ", ".join(f"{one['psnr']:.1f} dB of {one['covered']:.0%}" for one in found))
    check(equals(found), f"expected the photographs with {LEAST_PSNR} dB over {LEAST_COVERED:.0%}, found {found}")
    browser.check_silence()
    check_noticed(browser, run, [mirror] + ([swap_focal_lengths, centre] if odd else []))


def more_opaque(data):
    """Nothing of the Gaussians but their colours is left: their axes are all as long as the longest."""
    data["splats"]["scale_low"] += 255 * data["splats"]["scale_step"]
    data["splats"]["scale_step"] = 1e-9


def mirror_splats(data):
    data["splats"]["low"][0] *= -1
    data["splats"]["step"][0] *= -1


def test_splats(browser, run):
    """Gaussians stand in the place of the points until the reader asks for these."""
    browser.open(run / "report.html")
    count = browser.run("return page.splats.count")
    check(count > 500, f"expected Gaussians, found {count}")
    found = at_sources(browser, run)
    print("Gaussians at the source cameras:", ", ".join(f"{one['psnr']:.1f} dB of {one['covered']:.0%}" for one in found))
    check(equals(found), f"expected the photographs with {LEAST_PSNR} dB over {LEAST_COVERED:.0%}, found {found}")
    picture = browser.drawn_picture()
    browser.run("document.getElementById('show-splats').click()")
    check(browser.drawn_picture() != picture, "expected points in the place of Gaussians, found the same picture")
    check(equals(at_sources(browser, run)), "expected the photographs by the points as well")
    browser.run("document.getElementById('show-splats').click()")
    browser.check_silence()
    check_noticed(browser, run, [more_opaque, mirror_splats])


def check_double_click(browser):
    """Sets what the view turns about, from the overview and with no camera in the way; returns the new pivot."""
    browser.run("gldPage.viewer.show('source', false); gldPage.viewer.show('generated', false); gldPage.viewer.overview()")
    browser.settle()
    canvas = browser.driver.find_element(By.CSS_SELECTOR, ".viewer canvas")
    browser.run("arguments[0].scrollIntoView({block: 'center'})", canvas)
    target = browser.run("return gldPage.viewer.controls.target.toArray()")
    ActionChains(browser.driver).move_to_element_with_offset(canvas, 40, 30).double_click().perform()
    browser.wait("return gldPage.viewer.settled && gldPage.viewer.controls.target.toArray().join() !== arguments[0].join()"
                 .replace("arguments[0]", json.dumps(target)))
    return browser.run("return gldPage.viewer.controls.target.toArray()")


def test_splats_without_points(browser, run):
    """A run with Gaussians and no cloud: they alone say how far things are."""
    check(not (run / "points.ply").exists(), "expected a run without points.ply")
    browser.open(run / "report.html")
    check(browser.run("return page.cloud.count") == 0, "expected a page without points")
    browser.settle()
    covered = browser.covered()
    check(covered > 0.05, f"expected an overview that shows the Gaussians, found {covered:.1%} of it covered")
    found = at_sources(browser, run)
    print("Gaussians without points at the source cameras:", ", ".join(f"{one['psnr']:.1f} dB of {one['covered']:.0%}" for one in found))
    check(equals(found), f"expected the photographs with {LEAST_PSNR} dB over {LEAST_COVERED:.0%}, found {found}")
    pivot = check_double_click(browser)
    away = browser.run("""
        const [x, y, z] = arguments[0], {centres, count} = gldPage.viewer.splats;
        let least = Infinity;
        for (let i = 0; i < count; ++i) least = Math.min(least, Math.hypot(centres[3 * i] - x, centres[3 * i + 1] - y, centres[3 * i + 2] - z));
        return least / gldPage.viewer.depth;""", pivot)
    check(away < 1e-4, f"expected a pivot at a Gaussian, found one {away} of the scene's depth away from the nearest")
    browser.check_silence()


def test_moving(browser, run):
    browser.open(run / "report.html")
    browser.settle()
    canvas = browser.driver.find_element(By.CSS_SELECTOR, ".viewer canvas")
    browser.run("arguments[0].scrollIntoView({block: 'center'})", canvas)
    # A click on a camera's picture goes there, and shows the picture over the cloud.
    x, y = browser.run("""
        const {viewer} = gldPage, face = viewer.frusta[1].picture.geometry.attributes.position;
        const middle = new THREE.Vector3();
        for (let i = 0; i < 6; ++i) middle.add(new THREE.Vector3().fromBufferAttribute(face, i).multiplyScalar(1 / 6));
        const place = middle.applyMatrix4(viewer.frusta[1].group.matrixWorld).project(viewer.eye);
        return [place.x * viewer.size.width / 2, -place.y * viewer.size.height / 2];""")
    ActionChains(browser.driver).move_to_element_with_offset(canvas, round(x), round(y)).click().perform()
    browser.wait("return gldPage.viewer.settled && gldPage.viewer.at >= 0")
    at = browser.run("return gldPage.viewer.at")
    check(browser.run("return gldPage.viewer.frusta.length") == 6, "expected 6 cameras")
    check(browser.run("return gldPage.viewer.overlay.getAttribute('src') === page.pictures[page.views[arguments[0]].picture]", at),
          "expected the picture of the camera over the cloud")
    check(browser.run("return gldPage.viewer.overlay.style.opacity") == "1", "expected a picture that is seen")
    names = browser.run("return page.views.map((view) => view.name)")
    check(names[at] in browser.driver.find_element(By.CSS_SELECTOR, ".viewer .place").text, "expected the camera's name")
    # A drag changes the picture and takes the photograph away.
    before = browser.picture()
    ActionChains(browser.driver).move_to_element(canvas).click_and_hold().move_by_offset(90, 25).release().perform()
    browser.wait("return gldPage.viewer.at < 0 && gldPage.viewer.settled")
    browser.wait_for_other_picture(before, "a drag")
    check(browser.run("return gldPage.viewer.overlay.style.opacity") == "0", "expected the photograph to go")
    # So do keys; n goes to a camera.
    before = browser.picture()
    canvas.send_keys(Keys.ARROW_RIGHT)
    browser.wait_for_other_picture(before)
    canvas.send_keys("n")
    browser.wait("return gldPage.viewer.settled && gldPage.viewer.at >= 0")
    # A double click sets what the view turns about, on a point of the cloud.
    check_double_click(browser)
    # Sliders: fewer and larger points.
    browser.settle()
    all_points = browser.covered()
    browser.set_slider("confidence", 0.5)
    browser.settle()
    half = browser.covered()
    check(0.2 * all_points < half < 0.9 * all_points, f"expected about half of {all_points:.1%} to stay covered, found {half:.1%}")
    browser.set_slider("point-size", 1.5)
    browser.settle()
    larger = browser.covered()
    check(larger > 1.05 * half, f"expected larger points to cover more than {half:.1%}, found {larger:.1%}")
    # The path plays until it is stopped.
    browser.run("document.getElementById('play').click()")
    browser.wait("return gldPage.viewer.playing !== null")
    place = browser.run("return gldPage.viewer.playing.place")
    browser.wait(f"return gldPage.viewer.playing.place !== {place}")
    browser.run("document.getElementById('play').click()")
    browser.wait("return gldPage.viewer.playing === null")
    browser.check_silence()
    # A browser that takes the graphics memory away and gives it back shows the same again, though nobody moved.
    browser.settle()
    before = browser.picture()
    check(browser.covered() > 0.05, "expected a scene that is seen")
    browser.run("window.taken = gldPage.viewer.renderer.getContext().getExtension('WEBGL_lose_context'); taken.loseContext()")
    browser.wait_for_other_picture(before, "the loss of the context")
    browser.run("taken.restoreContext()")
    browser.wait_for_picture(before, "the context's return")


def test_pictures(browser, run):
    browser.open(run / "report.html")
    views = browser.run("return page.views.map((view) => [view.role, view.file])")
    target = next(i for i, (role, _) in enumerate(views) if role == "target")
    cards = browser.driver.find_elements(By.CSS_SELECTOR, ".card")
    check(len(cards) == len(views), f"expected a card a view, found {len(cards)}")
    check("36.1 dB" in cards[target].text, f"expected the PSNR below the picture, found {cards[target].text}")
    cards[target].click()
    name = pathlib.Path(views[target][1]).name
    stage = browser.driver.find_element(By.ID, "stage")
    browser.run("arguments[0].scrollIntoView({block: 'center'})", stage)
    for end, key, file in [(100, None, f"images/{name}"), (0, "truth", f"truth/{name}"), (0, "nearest", views[target - 1][1])]:
        if key is not None:
            browser.driver.find_element(By.CSS_SELECTOR, f".beside button[data-key={key}]").click()
        browser.set_slider("compare", end)
        # The file's pixels, as they are on the page and as they are seen.
        which = "left" if end == 100 else "right"
        exact = browser.run_async("""
            const [which, png] = arguments;
            const left = document.querySelectorAll('#stage img')[1], right = document.querySelectorAll('#stage img')[0];
            const image = which === 'left' ? left : right;
            await image.decode();
            return {...await compare(image.src, png, image.naturalWidth, image.naturalHeight), cut: left.style.clipPath};""", which, png_address(run / file))
        check(exact["psnr"] > 90, f"expected the pixels of {file} at {end}, found {exact}")
        check(exact["cut"] == f"inset(0px {100 - end}% 0px 0px)", f"expected one picture alone at {end}, found {exact}")
        browser.run("for (const part of document.querySelectorAll('#stage .side, #stage .divider')) part.style.visibility = 'hidden'")
        seen = browser.run_async("""
            const [shot, png] = arguments;
            const image = document.querySelector('#stage img');
            return compare(shot, png, image.naturalWidth, image.naturalHeight);""",
            "data:image/png;base64," + stage.screenshot_as_base64, png_address(run / file))
        check(seen["psnr"] > 30, f"expected {file} to be seen at {end}, found {seen}")
    # The picture turns, and stops when it is told.
    turning = browser.driver.find_element(By.ID, "turning")
    first = turning.get_attribute("src")
    browser.wait("return document.getElementById('turning').src !== arguments[0]".replace("arguments[0]", json.dumps(first)), 5)
    # What was made, how and by which command.
    text = browser.driver.find_element(By.ID, "main").text
    for part in ["drawing", "1.5 s", "123 MB", "a" * 64, "gld sample --scene", "float32"]:
        check(part in text, f"expected {part!r} on the page")
    browser.check_silence()


def test_names(browser, run):
    browser.open(run / "report.html")
    check(browser.run("return window.hostile === undefined && document.querySelectorAll('img[src=x]').length === 0"),
          "expected names to be text, found an element of them")
    check(HOSTILE in browser.driver.find_element(By.TAG_NAME, "h1").text, "expected the scene's name as it is")
    check(HOSTILE in browser.driver.find_element(By.CSS_SELECTOR, ".card").get_attribute("title"), "expected the frame's name as it is")
    check("a word & a <tag>" in browser.driver.find_element(By.CSS_SELECTOR, ".doubts").text, "expected the doubt as it is")


def test_narrow_screen(browser, run):
    browser.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", {"width": 390, "height": 844, "deviceScaleFactor": 2, "mobile": True})
    browser.driver.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": True, "maxTouchPoints": 2})
    browser.open(run / "report.html")
    browser.settle()
    wide = browser.run("return document.documentElement.scrollWidth")
    check(wide <= 390, f"expected a page of 390 pixels, found {wide}")
    canvas = browser.driver.find_element(By.CSS_SELECTOR, ".viewer canvas")
    browser.run("arguments[0].scrollIntoView({block: 'center'})", canvas)
    box = browser.run("const b = arguments[0].getBoundingClientRect(); return [b.left + b.width / 2, b.top + b.height / 2]", canvas)
    before = browser.picture()
    for kind, move in [("touchStart", 0), ("touchMove", 30), ("touchMove", 60), ("touchEnd", None)]:
        points = [] if move is None else [{"x": box[0] + move, "y": box[1] + move / 3}]
        browser.driver.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
    browser.wait_for_other_picture(before)
    browser.driver.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    browser.driver.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": False})
    browser.check_silence()


def test_old_browser(browser, run):
    script = browser.driver.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": "delete window.DecompressionStream"})
    browser.open(run / "report.html")
    check("DecompressionStream" in browser.driver.find_element(By.ID, "no-cloud").text, "expected a sentence for the cloud")
    check(len(browser.driver.find_elements(By.CSS_SELECTOR, ".card")) == 6, "expected the pictures all the same")
    check(browser.run("return gldPage.viewer.frusta.length") == 6, "expected the cameras all the same")
    browser.check_silence()
    browser.driver.execute_cdp_cmd("Page.removeScriptToEvaluateOnNewDocument", {"identifier": script["identifier"]})


def test_without_3d(run):
    with Browser("--disable-3d-apis") as browser:
        browser.open(run / "report.html")
        check("shows no 3D" in browser.driver.find_element(By.ID, "no-cloud").text, "expected a sentence for the cloud")
        check(browser.run("return document.querySelector('.viewer') === null && document.querySelector('.panel') === null"),
              "expected no empty scene")
        check(len(browser.driver.find_elements(By.CSS_SELECTOR, ".card")) == 6, "expected the pictures all the same")
        check(browser.run("return document.querySelectorAll('#stages tbody tr').length") == 3, "expected the stages all the same")
        browser.check_silence()


def claims_sentence(report):
    """What the page of an ablation says first, counted here from the report that the page was made of."""
    verdicts = collections.Counter(claim["verdict"] for claim in json.loads(report.read_text())["claims"])
    check(len(verdicts) > 1, f"expected {report} to hold claims that came out differently, found {dict(verdicts)}")
    return f"Of {verdicts.total()} claims: {', '.join(f'{count} {verdict}' for verdict, count in sorted(verdicts.items()))}."


def test_results(browser, root, folder):
    for name, sentence, counts in [
            ("train", "400 steps were done", {"figure svg path": 8, "table tbody tr": 8, ".sheets img": 1}),
            ("eval", "Over 64 scenes", {"table tbody tr": 40}),
            ("ablate", claims_sentence(root / "docs/measured/ablations/sources/report.json"), {"table tbody tr": 10, ".sheets img": 1})]:
        browser.open(folder / f"{name}.html")
        check(sentence in browser.driver.find_element(By.CSS_SELECTOR, ".verdict").text, f"expected {sentence!r} on the page of gld {name}")
        for selector, least in counts.items():
            found = browser.run("return document.querySelectorAll(arguments[0]).length", selector)
            check(found >= least, f"expected at least {least} of {selector} on the page of gld {name}, found {found}")
        pictures = browser.run("return [...document.images].map((image) => { image.loading = 'eager'; return image.alt; })")
        browser.wait("return [...document.images].every((image) => image.complete)")
        check(browser.run("return [...document.images].every((image) => image.naturalWidth > 0)"), f"expected pictures that show, found {pictures}")
        browser.check_silence()


def main():
    begun = time.monotonic()
    program, result_pages, scratch = sys.argv[1], sys.argv[2], pathlib.Path(sys.argv[3])
    shutil.rmtree(scratch, ignore_errors=True)
    runs = {}
    for name in ["plain", "odd", "splats", "splats_without_points"]:
        runs[name] = scratch / name
        size = {"plain": "112x112", "odd": "128x70"}.get(name, "84x84")
        views = "2" if name.startswith("splats") else "3"  # a renderer in software draws few Gaussians a second
        subprocess.run([program, runs[name], size, views, views, name, HOSTILE, HOSTILE], check=True)
    root = pathlib.Path(__file__).resolve().parents[2]
    subprocess.run([result_pages, root, scratch / "results"], check=True)
    with Browser("--use-angle=swiftshader", "--enable-unsafe-swiftshader") as browser:
        test_cameras(browser, runs["plain"], odd=False)
        test_cameras(browser, runs["odd"], odd=True)
        test_splats(browser, runs["splats"])
        test_splats_without_points(browser, runs["splats_without_points"])
        test_moving(browser, runs["plain"])
        test_pictures(browser, runs["plain"])
        test_names(browser, runs["plain"])
        test_narrow_screen(browser, runs["plain"])
        test_old_browser(browser, runs["plain"])
        test_results(browser, root, scratch / "results")
    test_without_3d(runs["plain"])
    print(f"all of it in {time.monotonic() - begun:.0f} s")


if __name__ == "__main__":
    main()
