"""What other folders use of this one, and where each name is defined."""

from erosion.tables.frames import open_source as open_source
from erosion.tables.headings import unused_note as unused_note
from erosion.tables.headings import Wanted as Wanted
from erosion.tables.meanings import read_meanings as read_meanings
from erosion.tables.meanings import written_meanings as written_meanings
from erosion.tables.reader import open_table as open_table
from erosion.tables.reader import Table as Table
from erosion.tables.source import Source as Source
from erosion.tables.source import TableError as TableError
from erosion.tables.reader import Column as Column
