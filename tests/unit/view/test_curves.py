"""Curves of a run's history."""

import pytest
from matplotlib.image import imread

from pcontact.runtime.errors import InputError
from pcontact.view.curves import plot
from pcontact.view.show import plot_history


@pytest.fixture
def run(tmp_path):
    (tmp_path / "history.csv").write_text("time,contacts.a.force_y,phase\n1.0,2.5,one\n2.0,4.5,two\n")
    return tmp_path


def test_columns_over_each_other_or_over_the_time(run):
    path = plot_history([str(run), "contacts.a.force_y"], {"size": "500x400"})
    assert path == run / "contacts.a.force_y_over_time.png" and imread(path).shape[:2] == (400, 500)
    path = plot_history([str(run), "contacts.a.force_y", "time"], {"o": str(run / "curve")})
    assert path == run / "curve.png"


def test_a_column_that_is_not_there(run):
    with pytest.raises(InputError, match=r"no column 'contacts.b.force_y'; allowed: time, .*; the nearest is 'conta"):
        plot(run, ["time", "contacts.b.force_y"])
    with pytest.raises(InputError, match="found no history.csv"):
        plot(run / "nowhere", ["time"])
