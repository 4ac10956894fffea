# SPDX-License-Identifier: Apache-2.0
"""A Parquet file that grows by row groups and is complete after each of them."""

import io
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from skyhaul.errors import FileError
from skyhaul.evaluation.whole_file import WholeFile
from skyhaul.types import Array

_MAGIC = b"PAR1"
_PADDING = memoryview(bytes(1 << 20))


class _Tail(io.RawIOBase):
    """Keeps what is written after the first `skip` bytes."""

    def __init__(self) -> None:
        self.skip = 0
        self.data = bytearray()

    def writable(self) -> bool:
        return True

    def write(self, data: object) -> int:
        view = memoryview(data)  # type: ignore[arg-type]
        size = len(view)
        dropped = min(self.skip, size)
        self.skip -= dropped
        self.data += view[dropped:]
        return size


class GrowingParquet:
    """Appends row groups; after each the file on disk is whole and readable.

    A Parquet file ends with a footer that says where every column chunk lies. Each append writes
    the new row group over the old footer, and the new footer behind it, in one system call. When
    the disk is full the old footer is put back: the file keeps all row groups before.
    """

    def __init__(self, path: Path, schema: pa.Schema) -> None:
        self._schema = schema
        self._floats = [f.name for f in schema if pa.types.is_float64(f.type)]
        self._kinds = {
            f.name: f.type.to_pandas_dtype() for f in schema if not pa.types.is_float64(f.type)
        }
        self._file = WholeFile(path)
        self._file.write(_MAGIC)
        self._metadata: pq.FileMetaData | None = None
        self._footer = b""
        self._append(self._schema.empty_table())

    def append(self, rows: Array) -> None:
        """Write rows, (k, columns), as one row group; columns are cast to the schema's types.

        Raises:
            FileError: When the disk refuses; the file then is as it was before.
        """
        columns = []
        for column, field in zip(np.ascontiguousarray(rows.T), self._schema, strict=True):
            kind = self._kinds.get(field.name)
            data = pa.py_buffer(column if kind is None else column.astype(kind))
            columns.append(pa.Array.from_buffers(field.type, len(rows), [None, data]))
        self._append(pa.table(columns, schema=self._schema))

    def close(self) -> None:
        """Close the file; it has been whole before."""
        self._file.close()

    def _append(self, table: pa.Table) -> None:
        body, metadata = _row_group(table, self._file.tell(), self._floats)
        if self._metadata is not None:
            self._metadata.append_row_groups(metadata)
            metadata = self._metadata
        written = io.BytesIO()
        metadata.write_metadata_file(written)
        footer = written.getvalue()
        try:
            self._file.write_with_tail(body, footer[len(_MAGIC) :])
        except FileError:
            self._metadata = pq.read_metadata(io.BytesIO(self._footer)) if self._footer else None
            raise
        self._metadata, self._footer = metadata, footer


def _row_group(table: pa.Table, offset: int, floats: list[str]) -> tuple[bytes, pq.FileMetaData]:
    """One row group as it stands in a file at an offset, and the metadata that finds it there."""
    tail = _Tail()
    sink = pa.PythonFile(tail, mode="w")
    writer = pq.ParquetWriter(
        sink,
        table.schema,
        compression="lz4",
        use_dictionary=False,
        write_statistics=False,
        use_byte_stream_split=floats,
    )
    tail.data.clear()  # the writer's own magic; pyarrow wants to begin at 0, so move on now
    left = tail.skip = offset - len(_MAGIC)
    while left > 0:
        sink.write(_PADDING[: min(left, len(_PADDING))])
        left -= len(_PADDING)
    if table.num_rows:
        writer.write_table(table)
    writer.close()
    footer_size = int.from_bytes(tail.data[-8:-4], "little") + 8
    return bytes(tail.data[:-footer_size]), writer.writer.metadata
