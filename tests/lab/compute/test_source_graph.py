import pytest

from epiprior_lab.compute.source_graph import source_files

EMPTY = "pack/__init__ pack/base pack/idle other/__init__ other/deep/__init__ other/idle lazy/one lazy/two"
FILES = {f"{name}.py": "" for name in EMPTY.split()} | {
    "pack/step.py": "import other.deep.leaf\nfrom pack import helper, missing\nimport numpy as np\n",
    "pack/helper.py": "def f():\n    from . import late\n",
    "pack/late.py": "from .sub.inner import thing\n",
    "pack/sub/__init__.py": "from ..base import Base\n",
    "pack/sub/inner.py": "from pack import step\n",
    "other/deep/leaf.py": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from pack import idle\n",
    "lazy/__init__.py": "def __getattr__(name):\n    ...\n",
    "uses_module.py": "from lazy.one import name\n",
    "uses_name.py": "from lazy import name\n",
    "uses_package.py": "import lazy\n",
}


@pytest.fixture
def reached(tmp_path):
    for name, text in FILES.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return lambda name: {file.relative_to(tmp_path).as_posix() for file in source_files(tmp_path / name, tmp_path)}


def test_imports_are_followed_everywhere_through_cycles_and_from_outside(reached, tmp_path, tmp_path_factory):
    everything = {name for name in FILES if name.startswith(("pack/", "other/"))}
    assert reached("pack/step.py") == everything - {"pack/idle.py", "other/idle.py"}
    assert reached("pack/sub/inner.py") >= {"pack/sub/__init__.py", "pack/__init__.py", "pack/base.py"}
    assert reached("other/idle.py") == {"other/idle.py", "other/__init__.py"}
    whole = {"lazy/__init__.py", "lazy/one.py", "lazy/two.py"}
    assert reached("uses_name.py") == whole | {"uses_name.py"}
    assert reached("uses_package.py") == whole | {"uses_package.py"}
    assert reached("uses_module.py") == {"uses_module.py", "lazy/__init__.py", "lazy/one.py"}
    script = tmp_path_factory.mktemp("elsewhere") / "script.py"
    script.write_text("from other import idle\n", encoding="utf-8")
    other = tmp_path / "other"
    assert source_files(script, tmp_path) == {script, other / "__init__.py", other / "idle.py"}
