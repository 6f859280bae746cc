"""Control points by hand: what the server takes, refuses and writes. The page itself: test_label_page.py."""

import contextlib
import http.client
import json
import re
import signal
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace
from urllib.parse import urlsplit

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

import calls
from epiprior.errors import ImageError, OutputError, SettingsError
from epiprior.geometry import sampson_distance
from epiprior_lab.cli import app, main
from epiprior_lab.labels.by_hand.fit import MIN_JUDGED, fit_pairs
from epiprior_lab.labels.by_hand.server import LARGEST_BODY, LabelServer
from epiprior_lab.labels.by_hand.session import MOST_PAIRS, LabelError, LabelSession
from epiprior_lab.pairsets import DatasetError
from epiprior_lab.pairsets.files import read_control_points
from pictures import save, texture, turned_jpeg
from synthetic import make_pair

POINTS = [[10.25, 20.5, 30.0, 40.75], [0.0, -0.5, 99.5, 79.5], [-0.5, 59.5, 0.125, 1.0]]
SAVE = {"points": POINTS, "revision": ""}
JSON = {"Content-Type": "application/json"}
FILES = ["a.png", "b.png", "points.csv", "points.pair.json"]


def files_in(folder):
    return sorted(path.name for path in folder.iterdir())


@pytest.fixture
def images(tmp_path):
    """Two images of different sizes: 120 x 60 and 100 x 80."""
    return save(tmp_path / "a.png", texture(120, 60)), save(tmp_path / "b.png", texture(100, 80, seed=1))


@pytest.fixture
def session(images, tmp_path):
    return LabelSession(*images, tmp_path / "points.csv")


@contextlib.contextmanager
def serving(session):
    """Serve a session from a thread, which must have ended after the block."""
    with LabelServer(session) as running:
        running.thread = threading.Thread(target=running.serve, daemon=True)
        running.thread.start()
        yield running
        if running.thread.is_alive():
            running.shutdown()
        running.thread.join(5)
        assert not running.thread.is_alive()


@pytest.fixture
def server(session):
    with serving(session) as running:
        yield running


def ask(server, route="", body=None, *, path=None, method=None, **headers):
    """Return the status, the headers and the content of an answer; a body that is not bytes goes as JSON."""
    address = urlsplit(server.url)
    if body is not None:
        body, headers = body if isinstance(body, bytes) else json.dumps(body).encode(), JSON | headers
    method = method or ("GET" if body is None else "POST")
    with contextlib.closing(http.client.HTTPConnection("127.0.0.1", address.port, timeout=10)) as connection:
        connection.request(method, path or address.path + route, body, headers)
        answer = connection.getresponse()
        return answer.status, answer.headers, answer.read()


def get(server, route=""):
    status, headers, data = ask(server, route)
    assert status == 200
    return headers, data


def post(server, route, value, **headers):
    status, _, data = ask(server, route, value, **headers)
    assert status == 200, data
    return json.loads(data)


def refused(server, status, *request, **how):
    """Return the message of a refusal, after a check that it came with `status` and that nothing was written."""
    folder = server.session.out.parent
    before = {path: path.read_bytes() for path in folder.iterdir()}
    found, _, data = ask(server, *request, **how)
    assert (found, {path: path.read_bytes() for path in folder.iterdir()}) == (status, before)
    return json.loads(data)["error"]


def state_of(server):
    return json.loads(get(server, "state")[1])


def test_the_page_its_files_and_the_images_are_served_and_need_nothing_from_elsewhere(server, images, tmp_path):
    headers, page = get(server)
    assert headers["Content-Type"].startswith("text/html")
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    seen = {}
    waiting = [name.decode() for name in re.findall(rb'(?:href|src)="([^"]+)"', page) if not name.startswith(b"data:")]
    assert {"label.css", "main.js"} <= set(waiting)
    while waiting:
        if (name := waiting.pop()) not in seen:
            seen[name] = get(server, name)[1]
            waiting += [part.decode() for part in re.findall(rb'from "\./([\w.]+)"', seen[name])]
    assert len(seen) == 6
    assert not re.search(rb"https?://|@import|url\(", b"".join([page, *seen.values()]))
    for number, path in enumerate(images, start=1):
        headers, data = get(server, f"image/{number}")
        assert headers["Content-Type"] == "image/png"
        np.testing.assert_array_equal(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR), cv2.imread(path))
    # Features are found on the image as its EXIF orientation turns it; a click has to mean the same pixel.
    session = LabelSession(turned_jpeg(tmp_path / "turned.jpg"), images[1], tmp_path / "points.csv")
    assert session.state()["images"][0] == {"name": "turned.jpg", "width": 48, "height": 64}
    assert cv2.imdecode(np.frombuffer(session.images[0].png, np.uint8), cv2.IMREAD_UNCHANGED).shape[:2] == (64, 48)


def test_what_is_saved_is_a_control_point_file_and_is_continued(server, images, tmp_path):
    first, second = {"name": "a.png", "width": 120, "height": 60}, {"name": "b.png", "width": 100, "height": 80}
    empty = {"images": [first, second], "file": "points.csv", "points": [], "revision": ""}
    assert state_of(server).items() >= empty.items()
    revision = post(server, "save", SAVE)["revision"]
    out = tmp_path / "points.csv"
    rows = "10.250000,20.500000,30.000000,40.750000\n0.000000,-0.500000,99.500000,79.500000\n"
    assert out.read_text() == f"x1,y1,x2,y2\n{rows}-0.500000,59.500000,0.125000,1.000000\n"
    np.testing.assert_array_equal(np.column_stack(read_control_points(out)), POINTS)
    assert files_in(tmp_path) == FILES
    again = LabelSession(*images, out)
    assert again.state().items() >= {"points": POINTS, "revision": revision}.items()
    assert again.count() == 3
    (tmp_path / "points.pair.json").unlink()  # a file without its record is continued as well
    assert LabelSession(*images, out).state()["points"] == POINTS
    post(server, "save", {"points": [], "revision": revision})
    assert out.read_text() == "x1,y1,x2,y2\n"


@pytest.mark.parametrize(
    ("points", "message"),
    [
        *(([[1, 2, 3, value]], "pair 1: expected four finite numbers") for value in ("4", None, True, 10**400)),
        ([[1, 2, 3, 4], [1, 2, 3]], "pair 2: expected four finite numbers"),
        ([{"x1": 1}], "pair 1: expected four finite numbers"),
        ({"0": [1, 2, 3, 4]}, "points: expected a list"),
        (None, "points: expected a list"),
        ([[1, 2, 3, 4]] * (MOST_PAIRS + 1), "points: expected a list of at most"),
        ([[1, 2, 3, 4], [119.6, 2, 3, 4]], "pair 2: (119.6, 2) lies outside image 1, a.png, 120 x 60"),
        ([[1, 2, 3, 79.51]], "pair 1: (3, 79.51) lies outside image 2, b.png, 100 x 80"),
        ([[-0.6, 2, 3, 4]], "pair 1: (-0.6, 2) lies outside image 1"),
    ],
)
@pytest.mark.parametrize("route", ["save", "fit"])
def test_points_that_are_none_are_refused(server, points, message, route):
    assert message in refused(server, 422, route, {"points": points, "revision": ""})


@pytest.mark.parametrize(
    ("status", "message", "body"),
    [
        *((400, "not JSON", body) for body in (b"", b"points", b'{"points": [[1, 2]', b"\xff\xfe{}", b"[" * 100_000)),
        *((400, "not JSON", b'{"points": [[1, 2, 3, %s]]}' % n) for n in (b"NaN", b"Infinity", b"-Infinity")),
        (422, "expected four finite numbers", b'{"points": [[1, 2, 3, 1e999]], "revision": ""}'),
        (400, "expected a JSON object", b"[1]"),
    ],
)
def test_malformed_json_is_refused(server, status, message, body):
    assert message in refused(server, status, "save", body)


@pytest.mark.parametrize(
    ("status", "headers"),
    [
        (415, {"Content-Type": "text/plain"}),
        (411, {"Transfer-Encoding": "chunked"}),  # without a length
        (413, {"Content-Length": str(LARGEST_BODY + 1)}),  # before it is read
        *((403, {"Origin": origin}) for origin in ("http://127.0.0.1:1", "null")),
        # As after DNS rebinding: the page's own name made to point to loopback.
        *((403, {"Host": host}) for host in ("evil.example", "evil.example:{port}", "127.0.0.1:1", "")),
    ],
)
def test_a_write_needs_json_a_length_no_foreign_origin_and_this_servers_name(server, status, headers):
    headers = {name: value.format(port=server.server_port) for name, value in headers.items()}
    assert refused(server, status, "save", b"" if status in (411, 413) else SAVE, **headers)
    # A browser that asks first, for another page, sends nothing after this.
    assert ask(server, "save", method="OPTIONS", Origin="http://127.0.0.1:1")[0] == 501
    post(server, "save", SAVE, Origin=f"http://127.0.0.1:{server.server_port}")
    assert ask(server, "state", Host=f"localhost:{server.server_port}")[0] == 200
    assert server.server_address[0] == "127.0.0.1"


@pytest.mark.parametrize("path", ["/", "/state", "/wrong/state", "//state", "/{cut}/state", "/{long}/state", "/{bare}"])
def test_without_the_token_nothing_is_told_or_taken(server, path):
    token = urlsplit(server.url).path.strip("/")
    path = path.format(cut=token[:-1], long=token + "x", bare=token)
    for body in (None, {}):
        assert "wrong token" in refused(server, 403, body=body, path=path)


@pytest.mark.parametrize("route", ["nothing", "image/3", "image/", "../label.py", "page/index.html", "%2e%2e/fit.py"])
def test_other_addresses_lead_nowhere(server, route):
    for body in (None, {}):
        assert refused(server, 404, route, body)


def test_a_file_that_somebody_changed_is_not_overwritten(server, tmp_path):
    first = post(server, "save", SAVE)["revision"]
    second = post(server, "save", {"points": POINTS[:2], "revision": first})["revision"]
    assert "changed by somebody else" in refused(server, 409, "save", {"points": POINTS, "revision": first})
    (tmp_path / "points.csv").write_text("x1,y1,x2,y2\n1,2,3,4\n")
    refused(server, 409, "save", {"points": POINTS, "revision": second})
    state = state_of(server)
    assert state["points"] == [[1, 2, 3, 4]]
    post(server, "save", {"points": POINTS, "revision": state["revision"]})


def test_a_failed_write_leaves_the_old_file(session, monkeypatch, tmp_path):
    revision = session.save(POINTS, "")

    def fail(path, *_):
        path.write_text("half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("epiprior_lab.labels.by_hand.session.write_control_points", fail)
    calls.refused(OutputError, "No space left", session.save, POINTS[:1], revision)
    assert (session.state()["points"], files_in(tmp_path)) == (POINTS, FILES)


def test_another_pairs_file_is_kept(session, images, tmp_path):
    session.save(POINTS, "")
    out = tmp_path / "points.csv"
    assert LabelSession(*images, out, force=True).state()["points"] == POINTS
    other, before = (images[0], save(tmp_path / "c.png", texture(100, 80, seed=2))), out.read_bytes()
    for pair, message in ((other, r"another pair, a\.png and b\.png; --force"), (images[::-1], "the other way round")):
        calls.refused(LabelError, message, LabelSession, *pair, out)
    forced = LabelSession(*other, out, force=True)
    assert (forced.state()["points"], forced.count()) == ([], None)
    assert out.read_bytes() == before  # until something is saved
    forced.save(POINTS[:1], forced.state()["revision"])
    assert (forced.count(), LabelSession(*other, out).state()["points"]) == (1, POINTS[:1])
    calls.refused(LabelError, "another pair", LabelSession, *images, out)


def test_a_damaged_record_points_outside_the_images_and_what_else_is_wrong_are_named(session, images, tmp_path):
    session.save(POINTS, "")
    for record in ("", "{}", '{"image1": 1, "image2": 2}', "[1, 2]"):
        (tmp_path / "points.pair.json").write_text(record)
        calls.refused(LabelError, "cannot be read as the record", LabelSession, *images, tmp_path / "points.csv")
    (tmp_path / "p.csv").write_text("x1,y1,x2,y2\n1,2,3,4\n500,2,3,4\n")
    with pytest.raises(LabelError, match=r"p\.csv, point 2: \(500, 2\) lies outside image 1"):
        LabelSession(*images, tmp_path / "p.csv")
    a, b = images
    out = tmp_path / "points.csv"
    for name, data in (("text.jpg", b"no image"), ("empty.png", b""), ("copy.png", a.read_bytes())):
        (tmp_path / name).write_bytes(data)
    (tmp_path / "broken.csv").write_text("x1,y1,x2,y2\n1,2,three,4\n")
    for arguments, kind, message in (
        ((tmp_path / "none.png", b, out), ImageError, "no such image file"),
        ((a, tmp_path / "text.jpg", out), ImageError, "not an image"),
        ((tmp_path / "empty.png", b, out), ImageError, "not an image"),
        ((tmp_path, b, out), ImageError, "is a folder"),
        ((a, tmp_path / "copy.png", out), ImageError, "the same image"),
        ((a, b, a), OutputError, "unknown suffix"),
        ((a, b, tmp_path / "none" / "points.csv"), OutputError, "there is no folder"),
        ((a, b, tmp_path / "broken.csv"), DatasetError, "line 2: x2 = 'three'"),
    ):
        with pytest.raises(kind, match=message) as caught:
            LabelSession(*arguments)
        assert "\n" not in str(caught.value)
    assert LabelSession(a, b, tmp_path / "broken.csv", force=True).state()["points"] == []


def test_a_taken_or_impossible_port_is_an_error(server, session):
    for port, message in ((server.server_port, "cannot be used"), (70000, "expected 0 to 65535")):
        calls.refused(SettingsError, f"port = {port}[:,] {message}", LabelServer, session, port)


def clicked(count, **how):
    """Points of a scene, clicked in both images with noise, and the true F."""
    pair = make_pair(inliers=count, outliers=0, noise_px=0.3, **how)
    return pair.matches.x1, pair.matches.x2, pair.F


@pytest.mark.parametrize("seed", range(4))
def test_a_wrong_click_is_told_from_the_others(seed):
    x1, x2, truth = clicked(MIN_JUDGED + 4, seed=seed)
    clean = fit_pairs(x1, x2)
    assert not clean.far_off.any()
    assert not clean.one_plane
    assert np.median(clean.residuals) < 0.6
    wrong = x2.copy()
    line = truth @ [*x1[5], 1]
    wrong[5] += 15 * line[:2] / np.linalg.norm(line[:2])  # across its epipolar line, where it can be seen
    found = fit_pairs(x1, wrong)
    assert np.flatnonzero(found.far_off).tolist() == [5]
    assert found.residuals[5] > 5
    assert np.sqrt(np.mean(sampson_distance(found.F, x1, x2) ** 2)) < 1.5
    np.testing.assert_array_equal(fit_pairs(x1, wrong).F, found.F)


def test_few_points_are_not_judged_points_on_one_plane_are_told_and_the_server_fits(server):
    x1, x2, _ = clicked(MIN_JUDGED - 1)
    assert fit_pairs(x1[:7], x2[:7]) is None
    assert fit_pairs(x1[:8], x2[:8]).residuals.max() < 1
    x2[3] += 40
    assert not fit_pairs(x1, x2).far_off.any()
    assert fit_pairs(*clicked(15, scene="plane")[:2]).one_plane
    assert post(server, "fit", {"points": POINTS}) == {"F": None}
    x = np.random.default_rng(0).uniform(0, 59, (9, 4))
    sent = post(server, "fit", {"points": x.tolist()})
    np.testing.assert_allclose(sampson_distance(np.array(sent["F"]), x[:, :2], x[:, 2:]), sent["residuals"])
    assert sent["far_off"] == [False] * 9
    assert post(server, "fit", {"points": [[5, 5, 6, 6]] * 9})["F"] is None


# What a shell starts in the background ignores Ctrl+C; so would the program, were the tests started like this.
LISTENING = """
import signal
from epiprior_lab.cli import main
signal.signal(signal.SIGINT, signal.default_int_handler)
main()
"""


def test_the_command_ends_by_an_interrupt_and_says_what_it_wrote(images, tmp_path):
    command = [sys.executable, "-c", LISTENING, "label", "a.png", "b.png", "--out", "points.csv", "--no-browser"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path)
    url = next(found[0] for line in process.stdout if (found := re.search(r"http://127\.0\.0\.1:\d+/\S+", line)))
    post(SimpleNamespace(url=url), "save", {"points": POINTS[:2], "revision": ""})
    process.send_signal(signal.SIGINT)
    out, error = process.communicate(timeout=20)
    assert (process.returncode, error, out.splitlines()[-1]) == (0, "", "points.csv: 2 points")


def test_the_command_opens_the_browser_and_continues_a_file(session, images, tmp_path, monkeypatch):
    session.save(POINTS, "")
    opened = []

    def visit(url):
        opened.append(url)
        threading.Timer(0.2, post, (SimpleNamespace(url=url), "done", {})).start()

    monkeypatch.setattr("webbrowser.open", visit)
    result = CliRunner().invoke(app, ["label", *map(str, images), "--out", str(session.out)])
    assert result.exit_code == 0, result.output
    assert opened[0] in result.output
    assert f"{session.out}: continues 3 points" in result.output
    assert result.output.rstrip().endswith(f"{session.out}: 3 points")


def test_without_out_the_file_is_named_after_the_pair_and_lies_here(images, tmp_path, monkeypatch):
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    monkeypatch.setattr(LabelServer, "serve", lambda _: None)

    def run(*paths):
        return CliRunner().invoke(app, ["label", *map(str, paths), "--no-browser"])

    assert run(*images).output.startswith(f"Points are saved to {here / 'a-b.csv'}\n")
    session = LabelSession(*images, Path("a-b.csv"))
    session.save(POINTS, session.state()["revision"])
    assert run(*images).output.startswith("a-b.csv: continues 3 points\n")
    # The same names elsewhere are another pair: what is there stays.
    before = (here / "a-b.csv").read_bytes()
    (tmp_path / "others").mkdir()
    others = [save(tmp_path / "others" / path.name, texture(90, 70, seed=5 + k)) for k, path in enumerate(images)]
    refused = run(*others)
    assert isinstance(refused.exception, LabelError)
    assert "a-b.csv" in str(refused.exception)
    assert (here / "a-b.csv").read_bytes() == before


def test_an_error_of_the_command_is_one_line(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["epiprior-lab", "label", "none.png", "b.png", "--out", "points.csv"])
    calls.refused(SystemExit, "1", main)
    assert capsys.readouterr().err == "error: none.png: no such image file\n"
