"""The files that `erosion calibrate` writes."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from erosion.cli.errors import user_errors
from erosion.cli.options import CaseOptions
from erosion.cli.output import require_outputs

if TYPE_CHECKING:
    from erosion.calibration import Ranking


@Parameter(name="*")
@dataclasses.dataclass(frozen=True)
class FitFiles:
    """The files that are asked for."""

    plot: Annotated[Path | None, Parameter(help="Draw data, fits and band into this file (.svg, .png, .pdf).")] = None
    openfoam: Annotated[Path | None, Parameter(help="Write OpenFOAM ParticleErosion coefficients.")] = None
    fluent: Annotated[Path | None, Parameter(help="Write the angle function as a piecewise-linear table.")] = None
    write_case: Annotated[Path | None, Parameter(help="Write the best fit as a case file, for --case.")] = None

    @property
    def paths(self) -> tuple[Path | None, ...]:
        """All of them."""
        return self.plot, self.openfoam, self.fluent, self.write_case

    def require_writable(self, inputs: Sequence[Any]) -> None:
        """Know before the fit that all files can be written, and that none of them is read."""
        require_outputs(self.openfoam, self.fluent, self.write_case, plot=self.plot, inputs=inputs)

    def write(self, ranking: "Ranking", level: float, options: CaseOptions) -> tuple[list[Path], list[str]]:
        """Write the files; gives their paths, and what they lack."""
        from erosion.calibration import CalibrationError, to_case, to_fluent, to_openfoam
        from erosion.files import write_whole

        best, warnings = ranking.best, []
        texts: list[tuple[Path, str]] = []
        # What cannot be represented is refused before anything is written.
        with user_errors(CalibrationError):
            for path, to_form in ((self.openfoam, to_openfoam), (self.fluent, to_fluent)):
                if path is not None:
                    form = to_form(best)
                    texts.append((path, form.text()))
                    warnings += [form.warning] if form.warning else []
            if self.write_case is not None:
                text = to_case(best, str(self.write_case), **options.names(), doubts=ranking.doubts)
                texts.append((self.write_case, text))
            written = []
            if self.plot is not None:
                from erosion.plotting.calibrations import plot_calibration
                from erosion.plotting.style import save_plot

                written.append(save_plot(plot_calibration(ranking.best_first, level), self.plot))
            for path, text in texts:
                write_whole(path, text.encode())
                written.append(path)
        return written, warnings
