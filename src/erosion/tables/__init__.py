"""The one reader of tables: text, Parquet, Feather, Excel, and objects of pandas and xarray.

`__init__.pyi` lists the names. Each is imported on its first use, because pyarrow takes a tenth of a second.
"""

from erosion.extras import on_use

__getattr__ = on_use(__name__, __file__)
