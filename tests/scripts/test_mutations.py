# SPDX-FileCopyrightText: 2026 Scanstage Authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The faults that scripts/mutations.py plants are still of this code: it is run by hand, and its list must not rot."""

import ast

import pytest

from scripts.mutations import CODE, FAULTS, ROOT, TESTS


@pytest.mark.parametrize("fault", FAULTS, ids=[f"{fault.file}: {fault.old.split()[0]}" for fault in FAULTS])
def test_each_planted_text_is_in_the_code_once_and_makes_another_program(fault):
    text = (ROOT / CODE / fault.file).read_text()
    assert text.count(fault.old) == 1
    assert ast.dump(ast.parse(text.replace(fault.old, fault.new))) != ast.dump(ast.parse(text))
    assert all((ROOT / TESTS / name).is_file() for name in fault.tests.split())
