"""Items that say themselves what their active set says."""

import numpy as np

from pcontact.assembly.item import ActiveSet, Item, active_set
from pcontact.runtime import log


class Limited(Item):
    """Says how far Newton's method may go, as items once did."""

    name = "limited"

    def step_limit(self, u, y, falls=None):
        return 0.5


def test_an_item_that_answers_itself_is_asked_and_told_of():
    log.forget_warnings()
    own = active_set(Limited())
    assert own.step_limit(None, None) == 0.5 and own.closed_area() == 0.0
    np.testing.assert_array_equal(own.turned(None), np.zeros(4))
    (line,) = log.warnings()
    assert "item limited: step_limit" in line


def test_an_item_has_the_active_set_that_it_says_or_none():
    log.forget_warnings()
    item, own = Item(), ActiveSet()
    assert active_set(item) is None
    item.active = own
    assert active_set(item) is own and not log.warnings()
