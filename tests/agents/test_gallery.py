"""The gallery films what is missing, and shows what there is."""

import pytest

from agents.gallery import film_path, main


def test_films_are_made_once_and_shown_side_by_side(tmp_path, capsys):
    line = ["--scenarios", "office-small", "--associators", "jcbb", "true_association", "--driver", "nearest_frontier"]
    line += ["--budget", "6", "--jobs", "1", "--out", str(tmp_path)]
    films = [film_path(tmp_path, "office-small", name) for name in ("jcbb", "true_association")]
    films[1].write_bytes(b"a film")
    films[1].with_suffix(".png").write_bytes(b"its last picture")
    assert main(line) == 0
    shown = (tmp_path / "index.html").read_text()
    assert films[0].stat().st_size > 1000 and films[1].read_bytes() == b"a film"
    assert shown.count("<video") == 2 and films[0].name in shown and "true association" in shown
    assert "gallery:" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("line", "said"),
    [(["--scenarios", "offic"], "unknown scenario 'offic'"), (["--associators", "nn"], "nn"),
     (["--driver", "nobody"], "nobody"), (["--budget", "0"], "--budget must be at least 1")],
)  # fmt: skip
def test_bad_input_is_told_before_anything_is_filmed(tmp_path, line, said):
    with pytest.raises(ValueError, match=said):
        main([*line, "--out", str(tmp_path / "out")])
    assert not (tmp_path / "out").exists()
