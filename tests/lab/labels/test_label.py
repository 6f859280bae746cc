"""Control points by hand: what the server takes, refuses and writes. The page itself: test_label_page.py."""

import contextlib
import http.client
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from urllib.error import HTTPError
from urllib.parse import urlsplit
from urllib.request import Request, urlopen

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from epiprior.errors import EpipriorError, ImageError, OutputError, SettingsError
from epiprior.geometry import sampson_distance
from epiprior_lab.cli import app
from epiprior_lab.labels.by_hand.fit import MIN_JUDGED, fit_pairs
from epiprior_lab.labels.by_hand.server import LARGEST_BODY, LabelServer
from epiprior_lab.labels.by_hand.session import MOST_PAIRS, LabelError, LabelSession
from epiprior_lab.pairsets import DatasetError, write_control_points
from epiprior_lab.pairsets.files import read_control_points
from epiprior_lab.scenes.photography import encode_jpeg
from pictures import save, texture

POINTS = [[10.25, 20.5, 30.0, 40.75], [0.0, -0.5, 99.5, 79.5], [-0.5, 59.5, 0.125, 1.0]]


@pytest.fixture
def images(tmp_path):
    """Two images of different sizes: 120 x 60 and 100 x 80."""
    return save(tmp_path / "a.png", texture(120, 60)), save(tmp_path / "b.png", texture(100, 80, seed=1))


@pytest.fixture
def session(images, tmp_path):
    return LabelSession(*images, tmp_path / "points.csv")


@pytest.fixture
def server(session):
    with LabelServer(session) as running:
        thread = threading.Thread(target=running.serve, daemon=True)
        thread.start()
        yield running
        running.stop()
        thread.join(5)
        assert not thread.is_alive()


def get(server, route="", url=None):
    with urlopen(Request((url or server.url) + route), timeout=10) as answer:
        return answer.headers, answer.read()


def post(server, route, value, **headers):
    body = value if isinstance(value, bytes) else json.dumps(value).encode()
    headers = {"Content-Type": "application/json"} | {name.replace("_", "-"): text for name, text in headers.items()}
    with urlopen(Request(server.url + route, data=body, headers=headers), timeout=10) as answer:
        return json.loads(answer.read())


def refused(server, status, ask, *arguments, **keywords):
    """Return the message of a refusal, after a check that it came with `status` and that nothing was written."""
    before = server.session.out.read_bytes() if server.session.out.exists() else None
    with pytest.raises(HTTPError) as caught:
        ask(server, *arguments, **keywords)
    with caught.value as error:
        assert error.code == status
        message = json.loads(error.read())["error"]
    assert (server.session.out.read_bytes() if server.session.out.exists() else None) == before
    return message


# --- what is served


def test_the_page_and_its_files_are_there_and_need_nothing_from_elsewhere(server):
    headers, page = get(server)
    assert headers["Content-Type"].startswith("text/html")
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    named = re.findall(rb'(?:href|src)="([^"]+)"', page)
    assert {b"label.css", b"main.js"} <= set(named)
    seen, waiting = {}, [name.decode() for name in named if not name.startswith(b"data:")]
    while waiting:
        name = waiting.pop()
        if name not in seen:
            seen[name] = get(server, name)[1]
            waiting += [part.decode() for part in re.findall(rb'from "\./([\w.]+)"', seen[name])]
    assert len(seen) == 6
    for text in (page, *seen.values()):
        assert not re.search(rb"https?://|@import|url\(", text)


def test_the_images_are_served_as_opencv_sees_them(server, images):
    for number, path in enumerate(images, start=1):
        headers, data = get(server, f"image/{number}")
        assert headers["Content-Type"] == "image/png"
        np.testing.assert_array_equal(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR), cv2.imread(path))


def test_a_turned_photograph_is_shown_upright(images, tmp_path):
    """Features are found on the image as its EXIF orientation turns it; a click has to mean the same pixel."""
    jpeg = encode_jpeg(np.repeat(texture(120, 60)[:, :, None], 3, axis=2), 95)
    exif = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0"  # orientation 6: a quarter turn
    turned = tmp_path / "turned.jpg"
    turned.write_bytes(jpeg[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif + jpeg[2:])
    session = LabelSession(turned, images[1], tmp_path / "points.csv")
    assert session.state()["images"][0] == {"name": "turned.jpg", "width": 60, "height": 120}
    shown = cv2.imdecode(np.frombuffer(session.images[0].png, np.uint8), cv2.IMREAD_UNCHANGED)
    assert shown.shape[:2] == (120, 60)


def test_a_new_file_has_no_points_and_one_without_record_is_continued(server):
    state = json.loads(get(server, "state")[1])
    assert state["images"][0] == {"name": "a.png", "width": 120, "height": 60}
    assert state["images"][1] == {"name": "b.png", "width": 100, "height": 80}
    assert (state["file"], state["points"], state["revision"]) == ("points.csv", [], "")
    x = np.array(POINTS)
    write_control_points(server.session.out, x[:, :2], x[:, 2:])  # a file without record is continued
    assert json.loads(get(server, "state")[1])["points"] == POINTS


def test_what_is_saved_is_a_control_point_file_and_is_continued(server, images, tmp_path):
    revision = post(server, "save", {"points": POINTS, "revision": ""})["revision"]
    out = tmp_path / "points.csv"
    assert out.read_text() == (
        "x1,y1,x2,y2\n10.250000,20.500000,30.000000,40.750000\n0.000000,-0.500000,99.500000,79.500000\n"
        "-0.500000,59.500000,0.125000,1.000000\n"
    )
    np.testing.assert_array_equal(np.column_stack(read_control_points(out)), POINTS)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.png", "b.png", "points.csv", "points.pair.json"]
    again = LabelSession(*images, out)
    assert again.state()["points"] == POINTS
    assert again.state()["revision"] == revision
    assert again.count() == 3
    post(server, "save", {"points": [], "revision": revision})
    assert out.read_text() == "x1,y1,x2,y2\n"


# --- what is refused


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([[1, 2, 3, "4"]], "pair 1: expected four finite numbers"),
        ([[1, 2, 3, 4], [1, 2, 3]], "pair 2: expected four finite numbers"),
        ([[1, 2, 3, None]], "pair 1: expected four finite numbers"),
        ([[1, 2, 3, True]], "pair 1: expected four finite numbers"),
        ([[1, 2, 3, 10**400]], "pair 1: expected four finite numbers"),
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
    assert message in refused(server, 422, post, route, {"points": points, "revision": ""})


@pytest.mark.parametrize("number", ["NaN", "Infinity", "-Infinity", "1e999"])
def test_numbers_that_are_not_finite_are_refused(server, number):
    body = f'{{"points": [[1, 2, 3, {number}]], "revision": ""}}'.encode()
    refused(server, 422 if number == "1e999" else 400, post, "save", body)


@pytest.mark.parametrize("body", [b"", b"points", b'{"points": [[1,2,3,4]', b"\xff\xfe{}", b"[" * 100_000, b"[1]"])
def test_malformed_json_is_refused(server, body):
    message = "expected a JSON object" if body == b"[1]" else "not JSON"
    assert message in refused(server, 400, post, "save", body)


def status_of(server, method, route, **headers):
    """Return the status of the answer to a request of which only the head is sent."""
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=10)
    connection.putrequest(method, urlsplit(server.url).path + route, skip_host="Host" in headers)
    for name, value in headers.items():
        connection.putheader(name.replace("_", "-"), value)
    connection.endheaders()
    with contextlib.closing(connection):
        return connection.getresponse().status


def test_a_large_body_is_refused_before_it_is_read(server):
    length = str(LARGEST_BODY + 1)
    assert status_of(server, "POST", "save", Content_Type="application/json", Content_Length=length) == 413


def test_a_write_needs_json_a_length_and_no_foreign_origin(server):
    good = {"points": POINTS, "revision": ""}
    refused(server, 415, post, "save", good, Content_Type="text/plain")
    assert "another page" in refused(server, 403, post, "save", good, Origin="http://127.0.0.1:1")
    assert "another page" in refused(server, 403, post, "save", good, Origin="null")
    assert status_of(server, "POST", "save", Content_Type="application/json") == 411
    assert post(server, "save", good, Origin=f"http://127.0.0.1:{server.port}")["revision"]


@pytest.mark.parametrize(
    "path", ["/", "/state", "/wrong/state", "//state", "/{short}/state", "/{long}/state", "/{bare}"]
)
def test_without_the_token_nothing_is_told_or_taken(server, path):
    token = urlsplit(server.url).path.strip("/")
    path = path.format(short=token[:-1], long=token + "x", bare=token)
    url = f"http://127.0.0.1:{server.port}{path}"
    assert "wrong token" in refused(server, 403, get, url=url)
    with pytest.raises(HTTPError) as caught:
        urlopen(Request(url, data=b"{}", headers={"Content-Type": "application/json"}), timeout=10)
    assert caught.value.code == 403
    caught.value.close()


def test_a_foreign_name_for_this_address_is_refused(server):
    """As after DNS rebinding: the page's own name made to point to loopback."""
    for host in ("evil.example", f"evil.example:{server.port}", "127.0.0.1:1", ""):
        assert status_of(server, "GET", "state", Host=host) == 403
    assert status_of(server, "GET", "state", Host=f"localhost:{server.port}") == 200
    assert server._http.server_address[0] == "127.0.0.1"


@pytest.mark.parametrize("route", ["nothing", "image/3", "image/", "../label.py", "page/index.html", "%2e%2e/fit.py"])
def test_other_addresses_lead_nowhere(server, route):
    refused(server, 404, get, route)
    refused(server, 404, post, route, {})


def test_a_file_that_somebody_changed_is_not_overwritten(server, tmp_path):
    first = post(server, "save", {"points": POINTS, "revision": ""})["revision"]
    second = post(server, "save", {"points": POINTS[:2], "revision": first})["revision"]
    assert "changed by somebody else" in refused(server, 409, post, "save", {"points": POINTS, "revision": first})
    (tmp_path / "points.csv").write_text("x1,y1,x2,y2\n1,2,3,4\n")
    refused(server, 409, post, "save", {"points": POINTS, "revision": second})
    state = json.loads(get(server, "state")[1])
    assert state["points"] == [[1, 2, 3, 4]]
    post(server, "save", {"points": POINTS, "revision": state["revision"]})


def test_a_failed_write_leaves_the_old_file(session, monkeypatch, tmp_path):
    revision = session.save(POINTS, "")

    def fail(path, *_):
        path.write_text("half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("epiprior_lab.labels.by_hand.session.write_control_points", fail)
    with pytest.raises(OutputError, match="No space left"):
        session.save(POINTS[:1], revision)
    assert session.state()["points"] == POINTS
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.png", "b.png", "points.csv", "points.pair.json"]


# --- another pair's file


def test_another_pairs_file_is_kept(session, images, tmp_path):
    session.save(POINTS, "")
    assert LabelSession(*images, tmp_path / "points.csv", force=True).state()["points"] == POINTS
    third = save(tmp_path / "c.png", texture(100, 80, seed=2))
    out = tmp_path / "points.csv"
    before = out.read_bytes()
    with pytest.raises(LabelError, match=r"belongs to another pair, a\.png and b\.png; --force"):
        LabelSession(images[0], third, out)
    with pytest.raises(LabelError, match="the other way round"):
        LabelSession(*images[::-1], out)
    forced = LabelSession(images[0], third, out, force=True)
    assert forced.state()["points"] == []
    assert forced.count() is None
    assert out.read_bytes() == before  # until something is saved
    forced.save(POINTS[:1], forced.state()["revision"])
    assert forced.count() == 1
    assert LabelSession(images[0], third, out).state()["points"] == POINTS[:1]
    with pytest.raises(LabelError, match="another pair"):
        LabelSession(*images, out)


def test_points_outside_the_images_are_another_pairs(images, tmp_path):
    (tmp_path / "points.csv").write_text("x1,y1,x2,y2\n1,2,3,4\n500,2,3,4\n")
    with pytest.raises(LabelError, match=r"points\.csv, point 2: \(500, 2\) lies outside image 1"):
        LabelSession(*images, tmp_path / "points.csv")


def test_the_pair_set_around_the_file_decides_whose_it_is(images, tmp_path):
    (tmp_path / "control_points").mkdir()
    (tmp_path / "pairs.csv").write_text(
        "pair_id,image1,image2,gt,scene,difficulty\np,a.png,b.png,control_points,s,\nq,b.png,a.png,control_points,s,\n"
    )
    out = tmp_path / "control_points"
    LabelSession(*images, out / "p.csv")
    LabelSession(*images, out / "new.csv")
    with pytest.raises(LabelError, match=r"pairs\.csv has b\.png and a\.png"):
        LabelSession(*images, out / "q.csv")
    assert LabelSession(*images, out / "q.csv", force=True).state()["points"] == []


def test_a_damaged_record_is_an_error(session, images, tmp_path):
    session.save(POINTS, "")
    for record in ("", "{}", '{"image1": 1, "image2": 2}', "[1, 2]"):
        (tmp_path / "points.pair.json").write_text(record)
        with pytest.raises(LabelError, match="cannot be read as the record"):
            LabelSession(*images, tmp_path / "points.csv")


# --- wrong arguments: one line each


def test_what_is_wrong_is_named(images, tmp_path):
    a, b = images
    out = tmp_path / "points.csv"
    text, copy, empty = tmp_path / "text.jpg", tmp_path / "copy.png", tmp_path / "empty.png"
    text.write_text("no image")
    empty.write_bytes(b"")
    copy.write_bytes(a.read_bytes())
    (tmp_path / "broken.csv").write_text("x1,y1,x2,y2\n1,2,three,4\n")
    cases = [
        ((tmp_path / "none.png", b, out), ImageError, "no such image file"),
        ((a, text, out), ImageError, "not an image"),
        ((empty, b, out), ImageError, "not an image"),
        ((tmp_path, b, out), ImageError, "is a folder"),
        ((a, copy, out), ImageError, "the same image"),
        ((a, b, a), OutputError, "unknown suffix"),
        ((a, b, tmp_path / "none" / "points.csv"), OutputError, "there is no folder"),
        ((a, b, tmp_path / "broken.csv"), DatasetError, "line 2: x2 = 'three'"),
    ]
    for arguments, kind, message in cases:
        with pytest.raises(kind, match=message) as caught:
            LabelSession(*arguments)
        assert isinstance(caught.value, EpipriorError)
        assert "\n" not in str(caught.value)
    assert LabelSession(a, b, tmp_path / "broken.csv", force=True).state()["points"] == []


def test_a_taken_or_impossible_port_is_an_error(server, session):
    with pytest.raises(SettingsError, match=f"port = {server.port}: cannot be used"):
        LabelServer(session, server.port)
    with pytest.raises(SettingsError, match="port = 70000, expected 0 to 65535"):
        LabelServer(session, 70000)


# --- the fit


def views(count, *, seed=0, noise=0.3, plane=False):
    """Points in space, or on one plane, as two cameras see them: 900 x 700 pixels, clicked with noise."""
    rng = np.random.default_rng(seed)
    X = rng.uniform((-2.5, -2, 5), (2.5, 2, 10), (count, 3))
    if plane:
        X[:, 2] = 7 + 0.3 * X[:, 0] - 0.2 * X[:, 1]
    K = np.array([[800.0, 0, 450], [0, 800, 350], [0, 0, 1]])
    angle = 0.15
    R = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    t = np.array([-1.2, 0.2, 0.3])
    seen = [X @ K.T, (X @ R.T + t) @ K.T]
    x1, x2 = (x[:, :2] / x[:, 2:] + rng.normal(scale=noise, size=(count, 2)) for x in seen)
    cross = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])
    return x1, x2, np.linalg.inv(K).T @ cross @ R @ np.linalg.inv(K)


@pytest.mark.parametrize("seed", range(4))
def test_a_wrong_click_is_told_from_the_others(seed):
    x1, x2, truth = views(MIN_JUDGED + 4, seed=seed)
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


def test_few_points_are_not_judged():
    x1, x2, _ = views(MIN_JUDGED - 1)
    assert fit_pairs(x1[:7], x2[:7]) is None
    assert fit_pairs(x1[:8], x2[:8]).residuals.max() < 1
    x2[3] += 40
    assert not fit_pairs(x1, x2).far_off.any()


def test_points_on_one_plane_are_told():
    x1, x2, _ = views(15, plane=True)
    assert fit_pairs(x1, x2).one_plane


def test_the_server_fits(server):
    assert post(server, "fit", {"points": POINTS}) == {"F": None}
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 59, (9, 4)).tolist()
    sent = post(server, "fit", {"points": points})
    x = np.array(points)
    np.testing.assert_allclose(sampson_distance(np.array(sent["F"]), x[:, :2], x[:, 2:]), sent["residuals"])
    assert sent["far_off"] == [False] * 9
    assert post(server, "fit", {"points": [[5, 5, 6, 6]] * 9})["F"] is None


# --- the command


# What a shell starts in the background ignores Ctrl+C; so would the program, were the tests started like this.
LISTENING = """
import signal
from epiprior_lab.cli import main
signal.signal(signal.SIGINT, signal.default_int_handler)
main()
"""


def start(arguments, tmp_path):
    """Start the command in a process of its own; return it and the page's address."""
    command = [sys.executable, "-c", LISTENING, "label", *arguments, "--no-browser"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path)
    for line in process.stdout:
        if found := re.search(r"http://127\.0\.0\.1:\d+/\S+", line):
            return process, found[0]
    raise AssertionError(process.communicate()[1])


@pytest.mark.parametrize("ending", ["done", "interrupt"])
def test_the_command_ends_and_says_what_it_wrote(images, tmp_path, ending):
    process, url = start(["a.png", "b.png", "--out", "points.csv"], tmp_path)
    headers = {"Content-Type": "application/json"}
    body = json.dumps({"points": POINTS[:2], "revision": ""}).encode()
    urlopen(Request(url + "save", data=body, headers=headers), timeout=10).close()
    if ending == "done":
        with urlopen(Request(url + "done", data=b"{}", headers=headers), timeout=10) as answer:
            assert json.loads(answer.read()) == {"count": 2}
    else:
        process.send_signal(signal.SIGINT)
    out, error = process.communicate(timeout=20)
    assert (process.returncode, error) == (0, "")
    assert out.splitlines()[-1] == "points.csv: 2 points"


def test_the_command_opens_the_browser_and_continues_a_file(session, images, tmp_path, monkeypatch):
    session.save(POINTS, "")
    opened = []

    def visit(url):
        opened.append(url)

        def press_done():
            time.sleep(0.2)
            request = Request(url + "done", data=b"{}", headers={"Content-Type": "application/json"})
            urlopen(request, timeout=10).close()

        threading.Thread(target=press_done, daemon=True).start()

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
    found = CliRunner().invoke(app, ["label", *map(str, images), "--no-browser"])
    assert found.exit_code == 0, found.output
    assert found.output.startswith(f"Points are saved to {here / 'a-b.csv'}\n")
    session = LabelSession(*images, Path("a-b.csv"))
    session.save(POINTS, session.state()["revision"])
    again = CliRunner().invoke(app, ["label", *map(str, images), "--no-browser"])
    assert again.output.startswith("a-b.csv: continues 3 points\n")

    # The same names elsewhere are another pair: what is there stays.
    before = (here / "a-b.csv").read_bytes()
    (tmp_path / "others").mkdir()
    others = [str(save(tmp_path / "others" / path.name, texture(90, 70, seed=5 + k))) for k, path in enumerate(images)]
    refused = CliRunner().invoke(app, ["label", *others, "--no-browser"])
    assert isinstance(refused.exception, LabelError)
    assert "a-b.csv" in str(refused.exception)
    assert (here / "a-b.csv").read_bytes() == before


def test_an_error_of_the_command_is_one_line(images, tmp_path):
    command = [sys.executable, "-m", "epiprior_lab.cli", "label", "a.png", "none.png", "--out", "points.csv"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, env=os.environ, check=False)
    assert (done.returncode, done.stderr) == (1, "error: none.png: no such image file\n")
