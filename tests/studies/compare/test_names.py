from carosac_toolkit.studies.compare.names import told_apart


def test_robots_of_one_name_are_told_apart_by_their_files():
    names = {"a/x.yaml": "rig", "a/y.yaml": "rig", "z.yaml": "lab"}
    assert list(told_apart(names).values()) == ["rig (x)", "rig (y)", "lab"]


def test_files_of_one_name_are_told_apart_by_their_paths():
    names = {"a/x.yaml": "rig", "b/x.yaml": "rig", "b/y.yaml": "rig"}
    assert list(told_apart(names).values()) == ["rig (a/x.yaml)", "rig (b/x.yaml)", "rig (y)"]
