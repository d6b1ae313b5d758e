"""The golden images, as pytest tests."""

import pytest


@pytest.mark.parametrize("name", ["front", "around", "from-camera"])
def test_a_render_is_its_golden_image(golden, name):
    golden(name)
