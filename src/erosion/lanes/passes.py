"""Passes over a complete graph: unused operations are dropped, and a product with its sum becomes one operation."""

from collections.abc import Iterable, Sequence

from erosion.lanes.graph import DOUBLE, Branch, Graph, Loop, Region, Step, Value


def finish(graph: Graph, outputs: Sequence[Value]) -> None:
    """Set a graph's outputs: drop what they do not need, count uses, and contract products and sums."""
    graph.outputs = list(outputs)
    _prune(graph.root, _live(graph.outputs))
    _count_uses(graph)
    _contract(graph.root)


def _live(outputs: Iterable[Value]) -> set[Value]:
    """What the outputs depend on."""
    live: set[Value] = set()
    waiting = list(outputs)
    while waiting:
        value = waiting.pop()
        if value in live:
            continue
        live.add(value)
        waiting += value.inputs
        if isinstance(value.extra, Loop):
            loop = value.extra
            i = (loop.arguments if value.op == "argument" else loop.results).index(value)
            waiting += (loop.condition, loop.initial[i], loop.updates[i], loop.arguments[i])
        elif isinstance(value.extra, Branch):
            branch = value.extra
            i = branch.results.index(value)
            waiting += (branch.selector, *(outputs[i] for outputs in branch.outputs))
    return live


def _prune(region: Region, live: set[Value]) -> None:
    kept: list[Step] = []
    for step in region.steps:
        if isinstance(step, Value):
            if step in live:
                kept.append(step)
            continue
        if isinstance(step, Loop):
            # A value of a loop may be needed only inside the loop.
            indices = [i for i, argument in enumerate(step.arguments) if argument in live]
            for name in ("arguments", "initial", "updates", "results"):
                setattr(step, name, [getattr(step, name)[i] for i in indices])
            inner = [step.head, step.body]
        else:
            indices = [i for i, result in enumerate(step.results) if result in live]
            step.results = [step.results[i] for i in indices]
            step.outputs = [[outputs[i] for i in indices] for outputs in step.outputs]
            inner = step.cases
        if indices:
            kept.append(step)
            for part in inner:
                _prune(part, live)
    region.steps = kept


def _count_uses(graph: Graph) -> None:
    def read(values: Iterable[Value]) -> None:
        for value in values:
            value.uses += 1

    def walk(region: Region) -> None:
        for step in region.steps:
            if isinstance(step, Value):
                for value in step.inputs:
                    value.uses += 1
            elif isinstance(step, Loop):
                read((step.condition, *step.initial, *step.updates))
                walk(step.head)
                walk(step.body)
            else:
                read((step.selector, *(value for outputs in step.outputs for value in outputs)))
                for case in step.cases:
                    walk(case)

    walk(graph.root)
    read(graph.outputs)


def _contract(region: Region) -> None:
    """Make a sum and the product that it alone reads one operation with one rounding, the first of two products.

    The choice depends on the graph alone, so the bits of a result do too.
    """
    taken: set[Value] = set()

    def is_product(value: Value) -> bool:
        return value.op == "fmul" and value.uses == 1 and value.region is region and value.type == DOUBLE

    for step in region.steps:
        if isinstance(step, Loop):
            _contract(step.head)
            _contract(step.body)
        elif isinstance(step, Branch):
            for case in step.cases:
                _contract(case)
        elif step.op in ("fadd", "fsub"):
            x, y = step.inputs
            minus = step.op == "fsub"
            if is_product(x):
                taken.add(x)
                step.op, step.inputs = ("fms" if minus else "fma"), (*x.inputs, y)
            elif is_product(y):
                taken.add(y)
                step.op, step.inputs = ("fnma" if minus else "fma"), (*y.inputs, x)
    region.steps = [step for step in region.steps if step not in taken]
