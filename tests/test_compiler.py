from erosion import compiler


def test_options_that_xla_does_not_know_are_left_out():
    known = {"xla_backend_optimization_level": 0}
    assert compiler._accepted((("xla_cpu_no_such_option", True), *known.items())) == known
