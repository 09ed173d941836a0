"""``companion review`` as a program: words, page, picture and comparison, of sessions and logs."""

import base64
import html.parser
import lzma
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from companion.cli import main
from companion.review.compare import pair, words
from companion.review.page import write_page
from companion.review.pair_show import recorded, write_pair_page
from companion.review.recordings import make_recordings
from companion.review.sources import open_flight
from companion.session.readback import read_recording

PICTURES = Path(__file__).parents[2] / "build" / "pictures"
"""Where CI finds what was rendered."""
DATA = Path(__file__).parents[1] / "data"


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """The two recordings of real autopilots, unpacked."""
    folder = tmp_path_factory.mktemp("logs")
    for packed in DATA.glob("*.tlog.xz"):
        (folder / packed.stem).write_bytes(lzma.decompress(packed.read_bytes()))
    return sorted(folder.iterdir())


class Page(html.parser.HTMLParser):
    """Collects the words of a page, what it fetches, and whether its tags are closed."""

    def __init__(self, text):
        super().__init__()
        self.open, self.words, self.fetched = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        if tag not in ("meta", "img", "line", "path", "rect", "circle", "polyline", "polygon"):
            self.open.append(tag)
        self.fetched += [v for k, v in attributes if k in ("src", "href") and v]

    def handle_endtag(self, tag):
        if tag in self.open:
            assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)


def check_page(path):
    text = path.read_text()
    page = Page(text)
    assert page.open == []
    assert all(link.startswith("data:") for link in page.fetched)
    assert "http" not in re.sub(r"base64,[^\"]*", "", text)
    assert "nan" not in re.sub(r"base64,[^\"]*", "", text).lower().split('"')
    return " ".join(page.words)


@pytest.fixture
def no_driver(monkeypatch):
    """A machine on which the viewer cannot draw."""
    monkeypatch.setenv("VK_ICD_FILENAMES", "/nowhere")
    monkeypatch.setenv("VK_DRIVER_FILES", "/nowhere")


def test_any_log_is_told_and_shown_on_a_page(logs, tmp_path, no_driver):
    for log in logs:
        said = check_page(write_page(open_flight(log), tmp_path / log.stem))
        for expected in (
            "What happened",
            "took off",
            "No picture of the viewer",
            "Height above take-off [m]",
            "Velocity north [m/s]",
        ):
            assert expected in said


def test_a_log_becomes_a_recording_that_reads_the_same(logs, tmp_path):
    flight = open_flight(logs[1])
    (recording,) = make_recordings(flight, tmp_path)
    again = read_recording(recording)
    modes = [[word for _, word in each.bands["mode"]] for each in (again, flight)]
    assert modes[0] == modes[1]
    assert sorted(event.text for event in again.events) == sorted(
        event.text for event in flight.events
    )
    assert again.vehicle.position_enu_m.shape == flight.vehicle.position_enu_m.shape


def test_two_flights_are_laid_side_by_side(logs, tmp_path, no_driver):
    both = pair(*(open_flight(log) for log in logs))
    text = words(both)
    assert max(map(len, text.splitlines())) <= 80
    assert "* Duration" in text
    assert "Apart at the same moment" in text
    said = check_page(write_pair_page(both, tmp_path / "page", at_s=None))
    assert "What stands out in" in said
    recording = recorded(both, tmp_path)
    assert recording.recording is not None
    assert recording.recording.stat().st_size > 10_000


def test_a_flight_beside_itself_does_not_differ(logs):
    flight = open_flight(logs[0])
    rows = pair(flight, flight).rows()
    assert {first == second for name, first, second in rows[:-2]} == {True}
    assert rows[-1][1:] == ("0.00 m/s on average", "0.00 m/s at most")


def test_wrong_numbers_of_flights_are_refused(logs, capfd):
    for arguments in ([], [logs[0], logs[1]], ["--compare", logs[0]]):
        with pytest.raises(SystemExit) as ended:
            main(["review", *map(str, arguments), "--text"])
        assert ended.value.code == 2
        assert len(capfd.readouterr().err.splitlines()) == 1


@pytest.mark.parametrize("name", ["summary.json", "config.json"])
@pytest.mark.parametrize("content", [b"", b"{", b"[1, 2]", b"\xff\xfe\x00"])
def test_a_damaged_file_is_a_line_and_no_traceback(tmp_path, capfd, name, content):
    (tmp_path / "flight.tlog").write_bytes(b"")
    (tmp_path / name).write_bytes(content)
    with pytest.raises(SystemExit) as ended:
        main(["review", str(tmp_path), "--text"])
    assert ended.value.code == 2
    (line,) = capfd.readouterr().err.splitlines()
    assert name in line


def test_the_page_of_a_flight_has_the_scene_in_it(logs, tmp_path, vulkan):
    page = write_page(open_flight(logs[0]), tmp_path).read_text()
    (data,) = re.findall(r'src="data:image/png;base64,([^"]+)"', page)
    PICTURES.mkdir(parents=True, exist_ok=True)
    (PICTURES / "log.png").write_bytes(base64.b64decode(data))
    with Image.open(PICTURES / "log.png") as picture:
        assert np.asarray(picture.convert("L"), dtype=float).std() > 5.0
