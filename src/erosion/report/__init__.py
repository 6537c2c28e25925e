"""The scenario's questions answered for a case, as one self-contained HTML page."""

from erosion.report.page import write_report as write_report
