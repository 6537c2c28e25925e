"""What leaves the package: text tables, whole files."""

from erosion.output.files import (
    Trace as Trace,
    beside as beside,
    claimed as claimed,
    digest as digest,
    is_file as is_file,
    read_toml as read_toml,
    readable as readable,
    require_finite as require_finite,
    require_no_pdf as require_no_pdf,
    require_writable as require_writable,
    seen_from as seen_from,
    trace as trace,
    write_whole as write_whole,
    written_whole as written_whole,
)
from erosion.output.tables import (
    Record as Record,
    abbreviate as abbreviate,
    briefly as briefly,
    first_of as first_of,
    format_number as format_number,
    largest_of as largest_of,
    sentences as sentences,
    to_csv as to_csv,
    to_html as to_html,
    to_json as to_json,
    to_lines as to_lines,
    to_plain as to_plain,
    with_error as with_error,
)
