"""Bad arguments in Python: one sentence in the house's voice, whatever comes in.

Bad tables of measurements: one sentence with file, line and column.
"""

import re
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from scipy import stats

import erosion
from erosion.fits import MeasurementError, read_measurements
from erosion.laws import JointLaw, JointSamples, RosinRammler, Samples
from tests.bad_input.conftest import unchecked_types

ROWS = [
    ("erosion.load_case(3)", "TypeError", "Argument `path` must be a path, but is 3."),
    ("erosion.load_case(None)", "TypeError", "Argument `path` must be a path, but is None."),
    (r"erosion.load_case('a\0b')", "ValueError", "Argument `path` must be a path, but 'a\\x00b' holds a zero byte."),
    ("erosion.load_case('')", "CaseError", ".: cannot be read (Is a directory)."),
    ("erosion.Parameters(k=1)", "TypeError", "missing 7 required"),
    ("erosion.Parameters(**{name: 1 for name in 'k psi r b m v0 sigma alpha beta'.split()})", "TypeError", "'beta'"),
    ("P.replace(k='two')", "ValueError", "Argument `k` must be a pure number such as 2, but 'two' cannot be read."),
    ("P.replace(v0='55')", "ValueError", "Argument `v0` must have a unit, such as \"110 m/s\", but has '55'."),
    ("P.replace(v0='50 : 60 m/s : 3')", "ValueError", "Argument `v0` must have a unit"),
    ("P.replace(v0=['50 m/s', 60])", "ValueError", "Argument `v0` must have a unit"),
    ("P.replace(alpha='20')", "ValueError", "Argument `alpha` must have a unit"),
    (
        "P.replace(k='2' * 10**6)",
        "ValueError",
        "but '222222222222222222222222222222222222222… (1,000,002 characters) cannot be read.",
    ),
    (
        "P.replace(k=[[1, 2], [3]])",
        "TypeError",
        "Argument `k` must hold real numbers of one shape, but has the type object.",
    ),
    ("P.replace(k=10**400)", "TypeError", "Argument `k` must hold real numbers"),
    ("P.replace(k=1j)", "TypeError", "Argument `k` must be a number"),
    ("P.replace(k=np.array([True, False] * 99))", "TypeError", "has the type bool."),
    ("P.replace(k=np.array([0.5, None] * 99, object))", "TypeError", "has the type object."),
    ("P.replace(k=np.full(99, 1j))", "TypeError", "has the type complex128."),
    ("P.replace(k=jnp.full(99, 1j))", "TypeError", "has the type complex128."),
    ("P.replace(k=jnp.array(True))", "TypeError", "has the type bool."),
    (
        "P.replace(k=pd.Series([1.0]))",
        "TypeError",
        "Argument `k` must be an array without labels: give its `.to_numpy()`.",
    ),
    ("P.replace(k=xr.DataArray([1.0]))", "TypeError", "Argument `k` must be an array without labels"),
    ("P.replace(k=np.ma.masked_less([1.0, 2.0], 1.5))", "ValueError", "Argument `k` must have no masked values"),
    ("P.replace(k=np.array(['2020-01-01'], 'M8[D]'))", "TypeError", "has the type datetime64[D]."),
    ("erosion.AnswerKey(P).check(['t_c'], 1)", "ValueError", "Argument `task` must be one of omega, "),
    ("P.replace(beta=1)", "TypeError", "Argument `beta` is not a parameter"),
    ("P.to(3)", "ValueError", "Argument `units` must be one of 'inch-pound', 'si', but is 3."),
    ("P.with_target(['copper'])", "ValueError", "Argument `target` must be text such as"),
    ("P.with_particle(3)", "ValueError", "Argument `particle` must be text such as"),
    ("erosion.validate(None)", "TypeError", "Argument `p` must be Parameters, but is None."),
    ("erosion.dump_case({})", "TypeError", "Argument `p` must be Parameters, but is {}."),
    (
        "erosion.load_model(erosion.models.Rotating(force=erosion.models.TanAlpha))",
        "ModelError",
        "its part `force` must be made, as in force=TanAlpha(), but is the class TanAlpha.",
    ),
    (
        "erosion.load_model(erosion.models.TanAlpha())",
        "ModelError",
        "is a part of one: give it to one, as in `erosion.models.Rotating(force=TanAlpha())`.",
    ),
    ("erosion.impact('finnie', None)", "TypeError", "Argument `p` must be Parameters, but is None."),
    (
        "erosion.impact('finnie', P.replace(alpha=20))",
        "ValueError",
        'is 1145.92° (20 rad; degrees are written "20 deg").',
    ),
    (
        "erosion.impact('finnie', P.replace(alpha=[1, 1], k=[1, 2, 3]))",
        "ValueError",
        "must broadcast against each other",
    ),
    ("erosion.impact(3, P)", "ModelError", "Argument `model` must be a model, its name or a path, but is 3."),
    (r"erosion.impact('a\0b.py', P)", "ModelError", "there is no such model file."),
    ("erosion.impact('finnie', P, rtol='a')", "ValueError", "Argument `rtol` must be in (0, 1), but is 'a'."),
    ("erosion.impact('finnie', P, rtol=np.array([1e-3, 1e-4]))", "ValueError", "Argument `rtol` must be in (0, 1)"),
    ("erosion.impact('finnie', P, rtol=0)", "ValueError", "Argument `rtol` must be in (0, 1), but is 0."),
    (
        "erosion.impact('finnie', P, derivatives='1')",
        "ValueError",
        "Argument `derivatives` must be 0, 1 or 2, but is '1'.",
    ),
    (
        "erosion.impact('finnie', P, derivatives=1, wrt=3)",
        "TypeError",
        "Argument `wrt` must be the name of a parameter",
    ),
    ("erosion.impact('finnie', P, derivatives=1, wrt=[['k']])", "ValueError", "Argument `wrt` must name parameters (k"),
    ("erosion.impact('finnie', P, derivatives=1, wrt=['k', 'k'])", "ValueError", "several different parameters"),
    ("erosion.impact(OWN, P, derivatives=1, wrt='fricton')", "ValueError", "phidot0, inertia, friction), but has"),
    ("erosion.impact('rotating', P, derivatives=1, wrt='friction')", "ValueError", "Argument `wrt` must name param"),
    (
        "OWN.replace(fricton=0.3)",
        "TypeError",
        "Argument `fricton` is not an own parameter of Rotating; it has friction",
    ),
    ("OWN.replace(friction='0.3')", "TypeError", "Argument `friction` must be a number, but is '0.3'."),
    ("OWN.replace(friction=[0.1, 0.2])", "TypeError", "Argument `friction` must be a number, but is [0.1, 0.2]."),
    ("OWN.replace(friction=np.inf)", "ValueError", "Argument `friction` must be a finite number, but is inf."),
    ("erosion.own_parameter(1.0, 'f', 'turns', 'Hz')", "ValueError", "Argument `dimension` must be one of 1, length"),
    ("erosion.next_test(None, [0.3])", "ValueError", "Argument `candidates` must be such as {'alpha': …"),
    ("erosion.next_test(None, noise='1')", "ValueError", "`noise` must be positive and finite, but is '1'."),
    (
        "erosion.next_test(None, noise=[1, -2])",
        "ValueError",
        "`noise` must be positive and finite, but is [1, -2].",
    ),
    ("erosion.PerMass('2700')", "TypeError", "Argument `density` must be a number, but is '2700'."),
    ("erosion.PerMass(cutting_fraction='50 %')", "TypeError", "`cutting_fraction` must be a number, but is '50 %'."),
    ("erosion.PerMass(cutting_fraction=[0.5])", "TypeError", "`cutting_fraction` must be a number, but is [0.5]."),
    ("erosion.PerMass(1e-320)", "ValueError", "Argument `density` must be at least 1e-09 kg/m³"),
    ("erosion.AnswerKey(P).check(np.array('t_c'), 1)", "ValueError", "but is array('t_c', dtype='<U3')."),
    ("erosion.volume('finnie', P.replace(k=[1, 2]))", "ValueError", "Argument `k` must be a scalar here"),
    ("erosion.simulate('finnie', P, rtol='a')", "ValueError", "Argument `rtol` must be in (0, 1), but is 'a'."),
    (
        "erosion.simulate('finnie', P, points=1.5)",
        "ValueError",
        "Argument `points` must be a whole number of at least 2",
    ),
    (
        "erosion.simulate('finnie', P, solver=3)",
        "TypeError",
        "Argument `solver` must be a diffrax.AbstractSolver, but is 3.",
    ),
    ("erosion.simulate('finnie', P, stepsize_controller=3)", "TypeError", "must be a diffrax.AbstractAdaptiveStepSize"),
    ("erosion.simulate('finnie', P.replace(k=[1, 2]))", "ValueError", "for many impacts use `erosion.impact`"),
    ("erosion.alpha_max('finnie', None)", "TypeError", "Argument `p` must be Parameters, but is None."),
    (
        "erosion.alpha_max('finnie', P, alpha_range='ab')",
        "ValueError",
        "two ascending angles within [0, 90°], but is 'ab'",
    ),
    (
        "erosion.alpha_max('finnie', P, alpha_range=3)",
        "ValueError",
        "two ascending angles within [0, 90°], but is 3 (numbers",
    ),
    ("erosion.alpha_max('finnie', P, alpha_range=(0.1,))", "ValueError", "must be two ascending angles"),
    ("erosion.alpha_max('finnie', P, objective=3)", "TypeError", "`objective` must be a name or a function, but is 3."),
    (
        "erosion.alpha_max('finnie', P, objective=lambda m: None)",
        "TypeError",
        "must turn a model into a model, but makes None.",
    ),
    ("erosion.compare('finnie', P)", "TypeError", "Argument `models` must be a list of models, but is 'finnie'."),
    ("erosion.compare(3, P)", "TypeError", "Argument `models` must be a list of models, but is 3."),
    ("erosion.compare(['finnie'], None)", "TypeError", "Argument `p` must be Parameters, but is None."),
    ("erosion.regimes('finnie', P.replace(k=[1, 2]))", "ValueError", "Argument `k` must be a scalar here"),
    ("erosion.sweep(None, P, alpha=[0.1])", "ModelError", "Argument `model` must be a model, its name or a path"),
    ("erosion.sweep('finnie', None, alpha=[0.1])", "TypeError", "Argument `p` must be Parameters, but is None."),
    (
        "erosion.sweep('finnie', P, alpha=[[0.1, 0.2], [0.3]])",
        "ValueError",
        "`alpha` must hold real numbers without units",
    ),
    ("erosion.sweep('finnie', P, alpha='abc')", "ValueError", "Argument `alpha` must be an angle such as"),
    ("erosion.sweep('finnie', P, speed=[1])", "TypeError", "Argument `speed` is not a parameter; they are k, psi"),
    (
        "erosion.sweep('finnie', P, friction=[1])",
        "TypeError",
        "Argument `friction` is not a parameter; they are k, psi",
    ),
    ("erosion.sweep(OWN, P, fricton=[1])", "TypeError", "phidot0, inertia, friction."),
    ("erosion.sweep(OWN, P, friction=0.1)", "ValueError", "`friction` must be a one-dimensional list of numbers"),
    ("erosion.sweep(OWN, P, friction=['a'])", "ValueError", "Argument `friction` must be a pure number such as 2"),
    ("erosion.sweep(OWN, P, friction=[0.1, np.nan])", "ValueError", "Argument `friction` must be finite, but is [0.1"),
    (
        "erosion.sweep([OWN, 'finnie'], P, friction=[1])",
        "ValueError",
        "Argument `friction` must be a parameter of every",
    ),
    (
        "erosion.sweep([OWN, 'finnie'], P, k=[1], wrt='friction')",
        "ValueError",
        "`friction` must be a parameter of every",
    ),
    (
        "erosion.stream('rotating', P, friction=stats.norm(0.2, 0.1))",
        "TypeError",
        "Argument `friction` is not a parameter; they are",
    ),
    ("erosion.stream(OWN, P, friction=0.3)", "TypeError", "Argument `friction` must be a law such as scipy"),
    (
        "erosion.stream(OWN.replace(friction=np.ones(2)), P, v0=stats.norm(1, 0.1))",
        "ValueError",
        "`friction` must be a scalar",
    ),
    (
        "erosion.simulate(OWN.replace(friction=np.ones(2)), P)",
        "ValueError",
        "`friction` must be a scalar here, but has sh",
    ),
    (
        "erosion.sweep('finnie', P, alpha=[0.1], rtol='a')",
        "ValueError",
        "Argument `rtol` must be in (0, 1), but is 'a'.",
    ),
    ("erosion.sweep('finnie', P, alpha=[0.1], wrt=['k'])", "ValueError", "Argument `wrt` must name a parameter"),
    (
        "erosion.sweep('finnie', P, alpha=[0.1], paired='alpha')",
        "TypeError",
        "Argument `paired` must be a list of axes",
    ),
    ("erosion.sweep('finnie', P, alpha=[0.1], optimum='no')", "TypeError", "Argument `optimum` must be true or false"),
    (
        "erosion.sweep('finnie', P, alpha=[0.1], chunks=3, store='x.zarr')",
        "TypeError",
        "must give lengths by dimension",
    ),
    ("erosion.sweep('finnie', P, alpha=[0.1], store=3)", "TypeError", "Argument `store` must be a path, but is 3."),
    (
        "erosion.stream('finnie', None, v0=stats.norm(112, 1))",
        "TypeError",
        "Argument `p` must be Parameters, but is None.",
    ),
    ("erosion.stream('finnie', P, v0=3)", "TypeError", "Argument `v0` must be a law such as scipy.stats.norm(1, 0.1)"),
    (
        "erosion.stream('finnie', P, uncertain=stats.norm(2, 0.1))",
        "TypeError",
        "Argument `uncertain` must be a mapping of parameters to laws, but is <scipy",
    ),
    (
        "erosion.stream('finnie', P, uncertain={'k': 3})",
        "TypeError",
        "Argument `k` must be a law such as scipy.stats.norm(1, 0.1)",
    ),
    ("erosion.stream('finnie', P, n=1e6, v0=stats.norm(112, 1))", "ValueError", "Argument `n` must be a whole number"),
    (
        "erosion.stream('finnie', P, n=True, v0=stats.norm(112, 1))",
        "ValueError",
        "Argument `n` must be a whole number",
    ),
    (
        "erosion.stream('finnie', P, seed='a', v0=stats.norm(112, 1))",
        "ValueError",
        "Argument `seed` must be a whole number",
    ),
    (
        "erosion.stream('finnie', P, seed=-1, v0=stats.norm(112, 1))",
        "ValueError",
        "`seed` must be a whole number of at least 0",
    ),
    (
        "erosion.stream('finnie', P, rtol='a', v0=stats.norm(112, 1))",
        "ValueError",
        "Argument `rtol` must be in (0, 1)",
    ),
    (
        "erosion.stream('finnie', P, store=3, v0=stats.norm(112, 1))",
        "TypeError",
        "Argument `store` must be a path, but is 3.",
    ),
    (
        "erosion.stream('finnie', P, v0=stats.norm([1, 2], 1))",
        "ValueError",
        "Argument `v0` must be a law with one finite number for each share",
    ),
    ("erosion.stream('finnie', P, v0=stats.norm(1, -1))", "ValueError", "one finite number for each share, but is not"),
    (
        "erosion.stream('finnie', P, samples=3)",
        "TypeError",
        "`samples` must be arrays by parameter, but is 3.",
    ),
    ("erosion.stream('finnie', P, correlation=3)", "TypeError", "Argument `correlation` must be a mapping of pairs"),
    ("Samples('abc')", "ValueError", "Argument `values` must hold real numbers without units"),
    ("Samples([])", "ValueError", "Argument `values` must be finite numbers, one or more, but is not."),
    ("JointSamples([1, 2])", "TypeError", "Argument `columns` must be arrays by parameter, but is [1, 2]."),
    ("RosinRammler(1, '3', 0.1)", "TypeError", "Argument `spread` must be a number, but is '3'."),
    (
        "JointLaw({'k': stats.norm(2, 1), 'r': stats.norm(1, 1)}, {('k', 'r'): '0.9'})",
        "ValueError",
        "Argument `correlation` must be in (-1, 1), but is '0.9' for k and r.",
    ),
    (
        "JointLaw({'k': stats.norm(2, 1), 'r': stats.norm(1, 1)}, {3: 0.9})",
        "ValueError",
        "Argument `correlation` must name pairs of k, r, but has 3.",
    ),
    (
        "erosion.calibrate(erosion.FitProblem('finnie', P, None, free=['k']))",
        "MeasurementError",
        "`data` must be the path of a table",
    ),
    (
        "erosion.calibrate(erosion.FitProblem('finnie', None, DATA, free=['k']))",
        "TypeError",
        "Argument `p` must be Parameters, but is None.",
    ),
    (
        "erosion.calibrate(erosion.FitProblem('finnie', P, DATA, free=3))",
        "TypeError",
        "Argument `free` must be a list of parameters, but is 3.",
    ),
    (
        "erosion.calibrate(erosion.FitProblem('finnie', P, DATA, free=[['k']]))",
        "ValueError",
        "Argument `free` must name parameters (k",
    ),
    (
        "erosion.calibrate(erosion.FitProblem(OWN, P, DATA, free=['fricton']))",
        "ValueError",
        "inertia, friction, cutting_fraction), but has 'fricton'.",
    ),
    (
        "erosion.calibrate(erosion.FitProblem('finnie', P, DATA, free=['friction']))",
        "ValueError",
        "(k, psi, r, b, m, v0, sigma, alpha, phidot0",
    ),
    (
        "erosion.calibrate(erosion.FitProblem('finnie', P, DATA, free=['k']), starts='a')",
        "ValueError",
        "Argument `starts` must be a whole number",
    ),
    (
        "erosion.calibrate(erosion.FitProblem('finnie', P, DATA, free=['k']), loss=3)",
        "ValueError",
        "Argument `loss` must be one of linear",
    ),
    (
        "erosion.calibrate(erosion.FitProblem('finnie', P, DATA, free=['k'], density=[1]))",
        "ValueError",
        "`density` must be positive and finite",
    ),
    ("erosion.read_measurements(DATA, 'cgs')", "ValueError", "Argument `shown_in` must be one of 'inch-pound', 'si'"),
    (r"erosion.available_models('a\0b')", "ValueError", "holds a zero byte"),
    ("erosion.available_models(3)", "TypeError", "Argument `path` must be a path, but is 3."),
    (
        "jax.jit(lambda k: erosion.impact('finnie', P.replace(k=k)))(0.3)",
        "TypeError",
        "Argument `k` must be a number or an array, but is traced",
    ),
    (
        "jax.jit(lambda k: erosion.alpha_max('finnie', P.replace(k=k)))(0.3)",
        "TypeError",
        "Argument `k` must be a number or an array, but is traced",
    ),
    (
        "jax.jit(lambda k: erosion.simulate('finnie', P.replace(k=k)))(0.3)",
        "TypeError",
        "Argument `k` must be a number or an array, but is traced",
    ),
    (
        "jax.jit(lambda k: erosion.sweep('finnie', P.replace(k=k), alpha=[0.1]))(0.3)",
        "TypeError",
        "Argument `k` must be a number or an array, but is traced",
    ),
    (
        "jax.jit(lambda k: erosion.sweep('finnie', P, alpha=[0.1, k]))(0.3)",
        "TypeError",
        "Argument `alpha` must be a number or an array, but is traced",
    ),
    (
        "jax.jit(lambda k: erosion.regimes('finnie', P.replace(k=k)))(0.3)",
        "TypeError",
        "Argument `k` must be a number or an array, but is traced",
    ),
    (
        "jax.jit(lambda k: erosion.stream('finnie', P.replace(k=k), v0=stats.norm(112, 40)))(0.3)",
        "TypeError",
        "Argument `k` must be a number or an array, but is traced",
    ),
    (
        "jax.jit(lambda k: erosion.calibrate(erosion.FitProblem('finnie', P.replace(k=k), DATA, ['psi'])))(0.3)",
        "TypeError",
        "Argument `k` must be a number or an array, but is traced",
    ),
    (
        "jax.jit(lambda k: erosion.impact(OWN.replace(friction=k), P))(0.3)",
        "TypeError",
        "Argument `friction` must be a number or an array, but is traced",
    ),
    (
        "jax.jit(lambda k: erosion.alpha_max(OWN.replace(friction=k), P))(0.3)",
        "TypeError",
        "Argument `friction` must be a number or an array, but is traced",
    ),
    (
        "jax.jit(lambda k: erosion.sweep(OWN.replace(friction=k), P, alpha=[0.1]))(0.3)",
        "TypeError",
        "Argument `friction` must be a number or an array, but is traced",
    ),
    (
        "jax.jit(lambda k: erosion.simulate(OWN.replace(friction=k), P))(0.3)",
        "TypeError",
        "Argument `friction` must be a number or an array, but is traced",
    ),
    (
        "jax.jit(lambda k: erosion.validate(P.replace(k=k)))(0.3)",
        "TypeError",
        "Argument `k` must be a number or an array, but is traced",
    ),
    (
        "erosion.FitProblem('finnie', INCH, DATA, ['sigma'], bounds={'sigma': (1e5, 3e5)})",
        "ValueError",
        "Argument `sigma` must have a unit, as the case is shown in inch-pound units, but is bare numbers",
    ),
    (
        "erosion.FitProblem.of_models(['finnie'], INCH, DATA, ['sigma'], bounds={'sigma': (1e5, 3e5)})",
        "ValueError",
        "Argument `sigma` must have a unit",
    ),
    (
        "erosion.FitProblem('finnie', INCH, DATA, ['sigma'], priors={'sigma': stats.norm(2e5, 1e4)})",
        "ValueError",
        'but the case is shown in inch-pound units: give `p.to("si")`.',
    ),
    (
        "erosion.FitProblem('finnie', INCH, DATA, ['psi']).conditions(0.3, {'v0': 4400.0})",
        "ValueError",
        'give v0="4400 in/s", or numbers in SI',
    ),
    (
        "erosion.stream('finnie', INCH, v0=stats.norm(4400, 100))",
        "ValueError",
        "Argument `v0` must come with a case that is shown in SI",
    ),
    (
        "erosion.stream('rotating-deformation', INCH, threshold=stats.norm(200, 10))",
        "ValueError",
        "Argument `threshold` must come with a case that is shown in SI",
    ),
    (
        "erosion.advise(INCH, particle='garnet 0.3 mm', target='copper', uncertain={'sigma': stats.norm(2e5, 1e4)})",
        "ValueError",
        "Argument `sigma` must come with a case that is shown in SI",
    ),
    (
        "erosion.calibrate(erosion.FitProblem('finnie', P, DATA, ['psi'], bounds=5))",
        "TypeError",
        "`bounds` must be a dictionary",
    ),
    (
        "erosion.calibrate(erosion.FitProblem('finnie', P, DATA, ['psi'], bounds=[('psi', 1, 2)]))",
        "TypeError",
        "`bounds` must be a dictionary",
    ),
    (
        "erosion.calibrate(erosion.FitProblem('finnie', P, DATA, ['psi'], bounds={'psi': 5}))",
        "ValueError",
        "`bounds` must give psi two ascending values",
    ),
    (
        "erosion.calibrate(erosion.FitProblem('finnie', P, DATA, ['psi'], bounds={'psi': ('a', 'b')}))",
        "ValueError",
        "Argument `psi` must be a pure number such as 2",
    ),
    (
        "erosion.calibrate(erosion.FitProblem('finnie', P, DATA, ['psi'], bounds={'psi': None}))",
        "ValueError",
        "`bounds` must give psi two ascending values",
    ),
    (
        "erosion.calibrate(erosion.FitProblem('finnie', P, DATA, ['psi'], bounds={'psi': (1, 2, 3)}))",
        "ValueError",
        "`bounds` must give psi two ascending values",
    ),
    (
        "erosion.calibrate(erosion.FitProblem('finnie', P, DATA, ['psi'])).intervals('0.95')",
        "ValueError",
        "Argument `level` must be in (0, 1)",
    ),
    (
        "erosion.calibrate(erosion.FitProblem('finnie', P, DATA, ['psi'])).intervals(None)",
        "ValueError",
        "Argument `level` must be in (0, 1)",
    ),
    (
        "erosion.calibrate(erosion.FitProblem('finnie', P, DATA, ['psi'])).intervals([0.9])",
        "ValueError",
        "Argument `level` must be in (0, 1)",
    ),
]


NAMES = {
    "np": np,
    "jax": jax,
    "jnp": jnp,
    "pd": pd,
    "xr": xr,
    "erosion": erosion,
    "stats": stats,
    "JointLaw": JointLaw,
    "JointSamples": JointSamples,
    "RosinRammler": RosinRammler,
    "Samples": Samples,
    "P": erosion.TABLE_1.to("si"),
    "INCH": erosion.TABLE_1,
    "DATA": {"angle [deg]": [10.0, 20.0, 30.0], "erosion [-]": [1.0, 2.0, 3.0]},
    "OWN": erosion.load_model(Path(__file__).parents[2] / "models" / "coulomb_tip.py"),
}


@unchecked_types
@pytest.mark.parametrize(("expression", "error", "message"), ROWS, ids=[expression for expression, _, _ in ROWS])
def test_a_bad_argument_is_one_sentence(tmp_path, monkeypatch, expression, error, message):
    monkeypatch.chdir(tmp_path)
    with pytest.raises((TypeError, ValueError), match=re.escape(message)) as caught:
        eval(expression, NAMES)
    assert caught.type.__name__ == error
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


HEAD = "angle [deg], volume [in^3/impact], uncertainty [in^3]\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", ": is empty."),
        ("\n\n", ": is empty."),
        (HEAD, " has no rows of data."),
        ("volume [in^3/impact]\n1\n", "has no column `angle [deg]`; its columns are 'volume [in^3/impact]'."),
        ("angle [deg]\n1\n", "must have one column of erosion (volume, mass_loss, erosion), but has none."),
        ("angle [deg],volume [in^3/impact],erosion [-]\n1,1,1\n", "Argument `ignore` may name the others."),
        ("angle [deg],temperature [K]\n1,1\n", "one column of erosion (volume, mass_loss, erosion), but has none."),
        ("angle [deg],angle [deg],erosion\n1,1,1\n", "column 'angle [deg]' gives `angle`, but so does 'angle"),
        ("angle [deg],volume\n1,1\n", "'volume' must have a unit, as `volume [mm^3/impact]`"),
        ("angle,volume [in^3/impact]\n1,1\n", "'angle' must have a unit, as `angle [deg]`"),
        ("angle [mm],volume [in^3/impact]\n1,1\n", "'angle [mm]': the unit must be that of an angle"),
        ("angle [deg],volume [kg]\n1,1\n", "must be that of a volume or volume per mass, but is 'kg'."),
        ("angle [deg],volume [blob]\n1,1\n", "but is 'blob'."),
        ("angle [deg],mass_loss [deg]\n1,1\n", "but is 'deg'."),
        ("angle [deg],volume [in^3/impact],uncertainty [g]\n1,1,1\n", "'uncertainty [g]' must have the unit of"),
        (HEAD + "20,1,1\n\n95,1,1\n", ", line 4: column `angle [deg]` must be above 0° and at most 90°, but is 95."),
        (HEAD + "0,1,1\n", ", line 2: column `angle [deg]` must be above 0° and at most 90°, but is 0."),
        (HEAD + "20,1,-2\n", ", line 2: column `uncertainty [in^3]` must be positive and finite, but is -2."),
        (HEAD + "20,1,0\n", "must be positive and finite, but is 0."),
        (HEAD + "20,much,1\n", ", line 2: column `volume [in^3/impact]` must be a number, but is 'much'."),
        (HEAD + "20,1_0,1\n", "must be a number, but is '1_0'."),
        (HEAD + "20,,1\n", "has no row with all of its numbers."),
        (HEAD + "20,nan,1\n", "has no row with all of its numbers."),
        (HEAD + "20,1\n", ", line 2: has 2 cells"),
        (HEAD + "20,0,1,5,0,1\n", "line 2: has 6 cells, but the header names 3 columns; with decimal commas"),
        (HEAD + '"20,5",1,1\n', "must be a number, but is '20,5'."),
        ("angle [deg];erosion\n1.234,5;1\n", "must be a number, but is '1.234,5'."),
        ('angle [deg],erosion\n"20,1\n', "line 2: has 1 cells"),
    ],
)  # fmt: skip
def test_a_bad_table_is_refused_with_its_place(table, text, message):
    path = table(text)
    with pytest.raises(MeasurementError, match=re.escape(message)) as caught:
        read_measurements(path, "inch-pound")
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"angle [deg]": [20, 120], "erosion": [1, 2]}, "`data`, row 1: column `angle [deg]` must be above 0°"),
        ({"angle [deg]": [20], "erosion": [1, 2]}, "must hold columns of one length"),
        ({"angle [deg]": [], "erosion": []}, "has no rows"),
        ({"angle [deg]": ["x"], "erosion": [1]}, "must hold real numbers"),
        ({"angle [deg]": [20]}, "must have one column of erosion"),
        ({"angle [m]": [20], "erosion": [1]}, "column 'angle [m]': the unit must be that of an angle"),
        (3, "must be the path of a table or columns by name, but is int"),
    ],
)
def test_bad_columns_in_memory(data, message):
    with pytest.raises(MeasurementError, match=re.escape(message)):
        read_measurements(data, "si")
