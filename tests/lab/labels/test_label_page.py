"""The page for control points in a real browser: a hand clicks what it sees, the file is compared with the truth.

Where the dots of the pictures lie is read off screenshots, so that nothing of the page's own arithmetic is believed.
"""

import contextlib

import numpy as np
import pytest

from browser import MISSING, Browser, find_browser
from epiprior_lab.labels.by_hand.session import LabelSession
from epiprior_lab.pairsets import write_control_points
from epiprior_lab.pairsets.files import read_control_points
from lab.labels.test_label import serving
from pictures import save, texture

pytestmark = [pytest.mark.slow, pytest.mark.skipif(find_browser() is None, reason=MISSING)]

READY = "document.body?.dataset.ready === 'yes'"
SAVED = "document.querySelector('#saved').textContent === 'saved'"
# Pure colours, which no marker has; the middle of each dot of 5 x 5 pixels, in both images.
DOTS = {
    (255, 0, 0): ((100, 80), (130, 95)),
    (0, 255, 0): ((522, 61), (401, 33)),
    (0, 0, 255): ((331, 400), (260, 277)),
    (255, 0, 255): ((2, 237), (341, 217)),
}
RED, GREEN, BLUE, PINK = DOTS


@pytest.fixture(scope="module")
def chromium(tmp_path_factory):
    browser = Browser(tmp_path_factory.mktemp("browser"))
    yield browser
    browser.close()


@pytest.fixture
def browser(chromium):
    """The browser with a window of 1300 x 700; no error may be left in its console."""
    chromium.resize(1300, 700)
    yield chromium
    chromium.send("Page.navigate", url="about:blank")
    errors, chromium.errors, chromium.questions = chromium.errors, [], []
    assert errors == []


@pytest.fixture
def serve(tmp_path):
    """Return a function that serves two images of different sizes with dots, and ``points.csv``."""
    images = []
    for side, (width, height) in enumerate(((640, 480), (420, 320))):
        picture = np.repeat(texture(width, height, seed=side)[:, :, None], 3, axis=2) // 3 + 80
        for colour, middles in DOTS.items():
            x, y = middles[side]
            picture[y - 2 : y + 3, x - 2 : x + 3] = colour
        images.append(save(tmp_path / f"{side + 1}.png", picture))
    with contextlib.ExitStack() as running:
        yield lambda: running.enter_context(serving(LabelSession(*images, tmp_path / "points.csv")))


class Hand:
    def __init__(self, browser):
        self.browser = browser

    def pane(self, side):
        """Return left, top, width and height of the canvas of an image, CSS pixels."""
        box = f"document.querySelector('#pane{side + 1} canvas').getBoundingClientRect()"
        return self.browser.run(f"(box => [box.x, box.y, box.width, box.height])({box})")

    def scale(self, side):
        return float(self.browser.text(f"#pane{side + 1} .where").split("·")[-1].strip(" %")) / 100

    def find(self, colour, side):
        """Return the middle of a dot on the screen, CSS pixels of the window."""
        self.browser.move(700, 10)  # away from the images: no loupe
        ratio = self.browser.ratio
        left, top, width, height = self.pane(side)
        shot = self.browser.screenshot((left, top, width, height)).astype(int)
        y, x = np.nonzero((np.abs(shot - colour) < 90).all(axis=2))
        assert len(x), f"no dot {colour} in image {side + 1}"
        # Pixels are numbered from their corner on: the middle of the first one is at 0.5.
        return left + (x.mean() + 0.5) / ratio, top + (y.mean() + 0.5) / ratio

    def click(self, place):
        """Click the pixel of the screen that holds a place; a mouse names pixels by their corner."""
        ratio = self.browser.ratio
        self.browser.click(*(np.floor(value * ratio) / ratio for value in place))

    def zoom(self, colour, side, scale):
        """Turn the wheel over a dot until a pixel of the image is that large."""
        place = self.find(colour, side)
        while self.scale(side) < scale:
            self.browser.wheel(*place, -200)

    def pair(self, colour):
        """Click a dot in both images; return the sizes of the screen's pixels there, in pixels of the images."""
        places = [self.find(colour, side) for side in (0, 1)]
        for place in places:
            self.click(place)
        return [1 / (self.scale(side) * self.browser.ratio) for side in (0, 1)]

    def rows(self):
        """Return number, coordinates and residual of each pair in the list, as shown."""
        cells = "['number', 'points', 'residual'].map(name => row.querySelector('.' + name).textContent)"
        return self.browser.run(f"[...document.querySelectorAll('#list li')].map(row => {cells})")

    def save(self):
        self.browser.key("s", "Ctrl")
        self.browser.wait(SAVED)

    def press_save_in_vain(self, message):
        self.browser.press("#save")
        self.browser.wait("!document.querySelector('#message').hidden")
        assert message in self.browser.text("#message span")


@pytest.fixture
def hand(browser):
    return Hand(browser)


def points(path):
    return np.column_stack(read_control_points(path))


def dots(*colours):
    return np.array([np.concatenate(DOTS[colour]) for colour in colours], dtype=float)


@pytest.mark.parametrize("ratio", [1, 2])
def test_clicks_at_different_zooms_become_a_control_point_file(browser, hand, serve, tmp_path, ratio):
    server = serve()
    browser.resize(1300, 700, ratio)
    browser.open(server.url, READY)
    assert browser.text("#hint").startswith("Click a point in either image")
    assert browser.text("#pane1 h2") == "1 1.png  ·  640 × 480"
    sizes = [hand.pair(RED)]  # whole images, less than their own size
    assert hand.scale(0) < 1
    hand.zoom(GREEN, 0, 4)
    hand.zoom(GREEN, 1, 3)
    sizes.append(hand.pair(GREEN))
    browser.drag((300, 350), (340, 320))  # the image moves along, and so do markers
    hand.zoom(GREEN, 0, 8)
    hand.pair(GREEN)  # selects the pair that is there: nothing new
    assert len(hand.rows()) == 2
    browser.press("#fit")
    hand.zoom(BLUE, 0, 16)
    hand.zoom(BLUE, 1, 20)
    sizes.append(hand.pair(BLUE))
    browser.press("#fit")
    hand.zoom(PINK, 1, 10)
    sizes.append(hand.pair(PINK))  # one image close, the other whole
    for count in (3, 2):
        browser.key("z", "Ctrl")  # the partner of the pink point, then the point itself
        browser.key("z", "Ctrl")
        assert len(hand.rows()) == count
    browser.press("#redo")
    browser.press("#redo")
    browser.key("Z", "Ctrl", "Shift")
    browser.key("y", "Ctrl")
    assert ([row[0] for row in hand.rows()], browser.text("#saved")) == (["1", "2", "3", "4"], "not saved")
    hand.save()
    found = points(tmp_path / "points.csv")
    assert found.shape == (4, 4)
    errors = np.abs(found - dots(RED, GREEN, BLUE, PINK))
    assert (errors < np.repeat(sizes, 2, axis=1)).all(), (errors, sizes)
    assert errors[2].max() < 0.1  # close up, far less than the half pixel between two conventions
    server.session.checked(found.tolist())
    browser.press("#done")
    browser.wait("!document.querySelector('#end').hidden")
    assert "4 pairs of points in points.csv" in browser.text("#end")
    server.thread.join(5)
    assert not server.thread.is_alive()
    assert browser.questions == []


def test_a_point_without_partner_can_be_moved_dropped_and_is_not_saved(browser, hand, serve, tmp_path):
    browser.open(serve().url, READY)
    hand.click(hand.find(RED, 1))
    assert "in the first image" in browser.text("#hint")
    assert browser.run("document.querySelector('#pane1').classList.contains('wanted')")
    hand.click(hand.find(GREEN, 1))  # another thought: the same image again
    hand.click(hand.find(GREEN, 0))
    hand.click(hand.find(BLUE, 0))
    browser.key("Escape")
    hand.click(hand.find(RED, 0))
    hand.save()
    np.testing.assert_allclose(points(tmp_path / "points.csv"), dots(GREEN), atol=1.2)
    left, top, *_ = hand.pane(0)
    browser.key("Escape")
    browser.click(left + 3, top + 3)  # beside the image
    assert browser.text("#hint") == ""
    assert browser.run("document.querySelector('#undo').disabled") is False


def test_markers_are_moved_nudged_deleted_and_renumbered(browser, hand, serve, tmp_path):
    browser.open(serve().url, READY)
    for colour in (RED, GREEN, BLUE):
        hand.pair(colour)
    start = hand.find(GREEN, 0)
    browser.drag(start, (start[0] + 40, start[1] + 20))
    hand.save()
    moved = points(tmp_path / "points.csv")
    np.testing.assert_allclose(moved[1], (dots(GREEN) + np.array([40, 20, 0, 0]) / hand.scale(0))[0], atol=1.2)
    browser.key("z", "Ctrl")  # a drag is one step
    browser.press("#list li:nth-child(2)")  # both images are centred on the pair, at least twice their size
    for side, place in enumerate(DOTS[GREEN]):
        left, top, width, height = hand.pane(side)
        seen = hand.find(GREEN, side)
        assert np.hypot(seen[0] - left - width / 2, seen[1] - top - height / 2) < 4, place
    assert hand.scale(0) == 2
    browser.move(*hand.find(GREEN, 1))
    for _ in range(3):
        browser.key("ArrowRight")
    browser.key("ArrowUp", "Shift")
    hand.save()
    nudged = points(tmp_path / "points.csv")
    np.testing.assert_allclose(nudged[1, 2:], DOTS[GREEN][1] + np.array([1.5, -5]), atol=1.2)
    browser.key("Delete")
    assert [row[0] for row in hand.rows()] == ["1", "2"]
    hand.save()
    np.testing.assert_array_equal(points(tmp_path / "points.csv"), nudged[[0, 2]])
    browser.press("#list li:first-child button")
    browser.key("z", "Ctrl")
    browser.key("z", "Ctrl")
    hand.save()
    np.testing.assert_array_equal(points(tmp_path / "points.csv"), nudged)


def test_a_file_is_continued_and_leaving_unsaved_work_asks(browser, hand, serve, tmp_path):
    write_control_points(tmp_path / "points.csv", np.array([[10.5, 20.25]]), np.array([[30.125, 40.0]]))
    url = serve().url
    browser.open(url, READY)
    assert (hand.rows(), browser.text("#saved")) == ([["1", "10.5, 20.330.1, 40.0", ""]], "saved")
    hand.pair(RED)
    browser.open(url, READY)
    assert (browser.questions, len(hand.rows())) == (["beforeunload"], 1)
    hand.pair(RED)
    hand.save()
    assert points(tmp_path / "points.csv")[0].tolist() == [10.5, 20.25, 30.125, 40.0]
    browser.open(url, READY)
    assert (browser.questions, len(hand.rows())) == (["beforeunload"], 2)


def rows_that_correspond(count):
    """Points whose epipolar lines are rows: row y of image 1 corresponds to row 0.6 y + 15 of image 2."""
    rng = np.random.default_rng(5)
    x1 = rng.uniform((200, 20), (400, 300), (count, 2)).round(1)
    return x1, np.column_stack([x1[:, 0] - rng.uniform(0, 180, count).round(1), 0.6 * x1[:, 1] + 15])


def test_a_wrong_point_is_marked_and_its_epipolar_line_drawn(browser, hand, serve, tmp_path):
    x1, x2 = rows_that_correspond(14)
    x2[3, 1] += 30
    write_control_points(tmp_path / "points.csv", x1, x2)
    browser.open(serve().url, READY)
    far = "[...document.querySelectorAll('#list li.far .number')].map(cell => cell.textContent)"
    browser.wait(f"{far}.length > 0")
    assert browser.run(far) == ["4"]
    assert "1 pair far off" in browser.text("#fitted")
    assert float(hand.rows()[3][2].split()[0]) > 15
    assert max(float(row[2].split()[0]) for k, row in enumerate(hand.rows()) if k != 3) < 0.5

    def line(side):
        """Return in which rows of an image there is a line of the colour of pair 4 from side to side."""
        left, top, width, height = hand.pane(side)
        inside = browser.screenshot((left + 20, top, width - 40, height)).astype(int)
        alike = (np.abs(inside - (60, 200, 150)) < 60).all(axis=2)
        scale = hand.scale(side)
        image_height = (480, 320)[side]
        return (np.flatnonzero(alike.mean(axis=1) > 0.8) + 0.5 - (height - image_height * scale) / 2) / scale - 0.5

    browser.move(700, 10)
    assert len(line(0)) == len(line(1)) == 0
    at = browser.run(
        "(box => [box.x + 60, box.y + 10])(document.querySelectorAll('#list li')[3].getBoundingClientRect())"
    )
    browser.move(*at)  # over the row of the list
    assert np.abs(line(1) - (0.6 * x1[3, 1] + 15)).min() < 1.5  # its line passes where the partner should be
    assert np.abs(line(0) - (x2[3, 1] - 15) / 0.6).min() < 1.5
    browser.key("l")
    assert len(line(1)) == 0
    browser.press("#list li:nth-child(4)")
    browser.key("Delete")
    browser.wait(f"{far}.length === 0 && document.querySelector('#fitted').textContent.startsWith('Residuals')")


def test_a_file_that_changed_meanwhile_is_a_question(browser, hand, serve, tmp_path):
    browser.open(serve().url, READY)
    for colour, text, button, count in (
        (RED, "1,2,3,4\n", "nth-child(2)", 1),  # load that file instead
        (GREEN, "", "first-child", 2),  # save mine all the same
    ):
        hand.pair(colour)
        (tmp_path / "points.csv").write_text(f"x1,y1,x2,y2\n{text}")
        hand.press_save_in_vain("changed by somebody else")
        browser.press(f"#message button:{button}")
        browser.wait(SAVED)
        assert len(hand.rows()) == len(points(tmp_path / "points.csv")) == count
    assert all("409" in error for error in browser.errors)
    browser.errors.clear()


def test_a_server_that_is_gone_is_said(browser, hand, serve):
    server = serve()
    browser.open(server.url, READY)
    hand.pair(RED)
    server.shutdown()
    server.thread.join(5)
    server.__exit__()
    hand.press_save_in_vain("The server does not answer")
    assert browser.text("#saved") == "not saved"
    browser.errors.clear()
