"""Names of the API: what there is is said, and results show themselves."""

import copy
import pickle

import numpy as np
import pytest

import pcontact as pc
from pcontact.api.study import _changed
from pcontact.api.tables import Named, Table, Tables, html

STEP = {
    "time": 1.0, "contacts": {"press": {"force": [0.0, -2.5], "area": 1.0, "max_pressure": 3.0}},
    "largest": {"displacement": {"value": 0.5, "place": [1.0, 2.0], "body": "<lid>"}},
}  # fmt: skip


def scene(**more):
    return pc.Scene(
        "m.msh", {"steel": {"E": 1.0, "nu": 0.3}}, {"lower": "steel", "upper": "steel"},
        [pc.Contact("a", "b"), pc.Contact("c", "d", name="press")],
        [pc.Displacement("top", [0, "free"]), pc.Displacement("top", ["free", 0])], **more,
    )  # fmt: skip


def test_tables_of_a_scene_by_name():
    """Also of lists that are put in later, of copies, and what is pickled."""
    one = scene()
    one.contacts["press"].friction = 0.3
    assert one.contacts[1].friction == 0.3 and one.contacts["a-b"] is one.contacts[0]
    assert one.bodies["upper"].material == "steel" and len(one.contacts[:1]) == 1
    one.loads = [pc.Load("side", pressure=1.0)]
    for made in (one, one.copy(), copy.deepcopy(one), pickle.loads(pickle.dumps(one))):
        assert made.loads["side"].pressure == 1.0 and made.contacts["press"].friction == 0.3
    for wrong, words in (
        (lambda: one.contacts["pres"], "'pres', no such name, the nearest is 'press'; there are a-b, press"),
        (lambda: one.displacements["top"], "the name of 2 tables; their numbers are 0, 1"),
        (lambda: one.springs["a"], "there are none"), (lambda: one.materials["stel"], "'steel'; there are steel"),
    ):  # fmt: skip
        with pytest.raises(KeyError) as error:
            wrong()
        assert words in error.value.args[0]
    assert one.contacts == list(one.contacts) and one.materials.get("stel") is None


def test_columns():
    table = Table({"time": np.arange(30.0), "force": np.arange(30.0) / 7})
    assert table.columns == ["time", "force"] and repr(table) == "<Table: 30 rows; columns time, force>"
    page = table._repr_html_()
    assert page.count("<tr>") == 21 and "30 rows" in page and "0.14286" in page
    assert isinstance(pickle.loads(pickle.dumps(table)), Table)
    with pytest.raises(KeyError, match="'tim', no such name, the nearest is 'time'; there are time, force"):
        table["tim"]
    assert html(["<a>"], [[None], [True], [(1.0, -0.0)]]).count("&lt;a&gt;") == 1


def test_results_show_themselves():
    run = pc.Run({"steps": [STEP], "converged": True, "warnings": ["too <soft>"]}, None, None)
    assert repr(run) == "<Run: converged, 1 load steps to time 1, 1 warnings; contacts press; fields >"
    page = run._repr_html_()
    for words in ("(0, -2.5)", "largest pressure", "&lt;lid&gt;", "too &lt;soft&gt;", "(1, 2)"):
        assert words in page
    assert run.table() is run.history and isinstance(run.table(), Table)
    with pytest.raises(KeyError, match="nearest is 'contacts.press.area'"):
        run.history["contacts.pres.area"]
    empty = pc.Run({"steps": [], "converged": False, "warnings": []}, None, None)
    assert "ended early, 0 load steps" in repr(empty) and empty._repr_html_()
    points = {"x": np.zeros((2, 2)), **{name: np.zeros(2) for name in ("pressure", "gap", "status", "weight")},
              "traction": np.zeros((2, 2)), "normal": np.zeros((2, 2))}  # fmt: skip
    contact = pc.ContactResult(points, STEP["contacts"]["press"])
    assert "2 points; force (0, -2.5), closed area 1" in repr(contact) and "largest pressure" in contact._repr_html_()
    data = (np.arange(2), np.arange(1), {"displacement": np.ones((2, 2))}, {"stress": np.zeros((1, 6))})
    fields = pc.Fields(1, 1.0, np.zeros((2, 2)), [], data, {"press": points})
    assert "fields displacement, stress; contacts press" in repr(fields) and "1 x 6" in fields._repr_html_()
    for wrong in (lambda: fields["stres"], lambda: fields.cell_data["stres"]):
        with pytest.raises(KeyError, match="the nearest is 'stress'"):
            wrong()
    with pytest.raises(KeyError, match="there are press"):
        fields.contacts["pres"]
    rows = [{"mu": 0.1, "converged": True, "error": ""}, {"mu": 0.2, "converged": False, "error": "no"}]
    study = pc.Study(rows)
    assert repr(study) == "<Study: 2 cases, 1 failed; columns mu, converged, error>" and "<td>no" in study._repr_html_()
    assert isinstance(study.table(), Table)
    with pytest.raises(KeyError, match="there are mu, converged, error"):
        study["nu"]


@pytest.mark.parametrize(
    ("where", "words"),
    [("contacts['pres'].friction", ("'pres'", "'press'", "a-b, press, 0, 1")),
     ("contacts[0].frction", ("'frction'", "'friction'", "allowed: source")),
     ("materials.stel.E", ("'stel'", "allowed: steel")), ("step.count", ("'step'", "'steps'")),
     ("contacts[5].friction", ("'5'", "a-b, press, 0, 1"))],
)  # fmt: skip
def test_a_study_says_what_there_is(where, words):
    with pytest.raises(pc.InputError) as error:
        _changed(scene(), {where: 1.0})
    for word in (f"study: found no {where!r} in the scene: ", *words):
        assert word in str(error.value)
    assert "held" not in str(error.value)
    assert _changed(scene(), {"contacts['press'].friction": 0.2}).contacts["press"].friction == 0.2


def test_lists_and_dicts_of_ones_own():
    assert Tables([pc.Body("a", "m")])["a"].material == "m" and Named({"a": 1})["a"] == 1
