from erosion import compiler


def test_options_that_xla_does_not_know_are_left_out():
    known = {"xla_backend_optimization_level": 0}
    assert compiler._accepted((("xla_cpu_no_such_option", True), *known.items())) == known


def test_functions_are_compiled_once():
    traced = []

    @compiler.quick_to_compile
    def double(x, *, times=2.0):
        traced.append(x)
        return times * x

    assert [float(double(x, times=3.0)) for x in (1.0, 1.0)] == [3.0, 3.0]
    assert len(traced) == 1
