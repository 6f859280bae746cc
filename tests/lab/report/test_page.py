from epiprior_lab.report.page import Page, Picture, Table, picture, render_html, render_markdown, say
from html_reader import Reader

HEAD, ROWS = ("who", "n"), [["all"], ["**a**", "1"]]
BESIDE = (Picture(path="a.png", alt="a"), Picture(path="b.png", alt="b", caption="*B*"))
PAGE = Page(
    title="A page",
    about="Of `code` and X_L & <b>.",
    sections={
        "Numbers": ["Some prose.", Table(head=HEAD, rows=ROWS, fold="Folded")],
        "Nothing here": ["Only prose.", Table(head=HEAD, rows=[])],
        "Side by side": [BESIDE],
    },
)  # fmt: skip


def test_markdown_and_html_are_whole_and_escaped():
    assert render_markdown(PAGE) == (
        "# A page\n\nOf `code` and X_L & <b>.\n\n## Numbers\n\nSome prose.\n\n### Folded\n\n"
        "| who | n |\n|---|---:|\n| **all** |  |\n| **a** | 1 |\n\n"
        "## Side by side\n\n![a](a.png)\n\n![b](b.png)\n\n*B*\n"
    )
    text = render_html(PAGE)
    read = Reader(text)
    assert (read.open, read.ids, read.links) == ([], ["numbers", "side-by-side"], ["#numbers", "#side-by-side"])
    assert (read.images, read.cells) == (["a.png", "b.png"], ["who", "n", "all", "a", "1"])
    about, folded = "Of <code>code</code> and X_L &amp; &lt;b&gt;.", "<details><summary>Folded</summary>"
    for part in (about, "<strong>a</strong>", "<em>B</em>", folded):
        assert part in text
    assert "Only prose" not in text


def test_prose_is_filled_in_and_wrapped_and_lists_stay_lists():
    lines = render_markdown(Page(title="t", about="- " + "word " * 60 + "\n- second", sections={})).splitlines()[2:]
    assert max(map(len, lines)) <= 110
    assert [line[:2] for line in lines] == ["- ", "  ", "  ", "- "]
    assert "thresholds" not in say("duels", champion="epiprior")
    assert "`epiprior` is ahead" in say("duels", champion="epiprior")
    assert "\n" not in say("summary")
    assert say("method", peers="", seeds=5).count("\n- ") == 4
    drawn = picture("calibration", "c.png", enough=20)
    assert (drawn.path, drawn.alt) == ("c.png", "Share of right matches over the stated probability")
    assert "fewer than 20 matches" in drawn.caption
