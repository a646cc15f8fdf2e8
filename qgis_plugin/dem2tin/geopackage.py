"""Fills a new GeoPackage in bulk: an OGR sink takes 40 microseconds a triangle, most of them for the R-tree.

OGR makes the file, with its tables, CRS and an empty R-tree; the rows and the nodes of the R-tree are then
inserted as numpy has laid them out.
"""

import contextlib
import sqlite3

import numpy as np

ROWS = 1 << 14  # at a time
BLOB = np.dtype(
    [
        ("magic", "S2"),
        ("version", "u1"),
        ("flags", "u1"),
        ("srs_id", "<i4"),
        ("envelope", "<f8", 4),
        ("wkb", "V109"),
    ]
)
LITTLE_ENDIAN_WITH_XY_ENVELOPE = 0b011
CELL = np.dtype([("id", ">i8"), ("box", ">f4", 4)])


def fill(path, polygons, boxes, columns, check):
    """Insert the rows of the only, still empty, layer of ``path``.

    ``polygons``: (m,) WKB of 109 bytes each; ``boxes``: (m, 4) min x, max x, min y, max y; ``columns``:
    {name: list of m}; ``check(fraction)`` is called now and then. Raises sqlite3.Error.
    """
    with contextlib.closing(sqlite3.connect(path)) as database:
        database.execute("PRAGMA synchronous=OFF")
        database.execute("PRAGMA journal_mode=OFF")
        query = "SELECT table_name, column_name, srs_id FROM gpkg_geometry_columns"
        table, geometry, srs_id = database.execute(query).fetchone()
        # The triggers keep count, extent and R-tree row by row; they come back when all rows are there.
        query = "SELECT name, sql FROM sqlite_master WHERE type = 'trigger'"
        triggers = database.execute(query).fetchall()
        for name, _ in triggers:
            database.execute(f"DROP TRIGGER {_quoted(name)}")
        blobs = _blobs(polygons, boxes, srs_id)
        names = ", ".join(map(_quoted, ("fid", geometry, *columns)))
        marks = ", ".join("?" * (2 + len(columns)))
        insert = f"INSERT INTO {_quoted(table)} ({names}) VALUES ({marks})"
        for start in range(0, len(blobs), ROWS):
            check(0.8 * start / len(blobs))
            block = slice(start, start + ROWS)
            numbers = range(start + 1, start + 1 + len(blobs[block]))
            values = (column[block] for column in columns.values())
            database.executemany(insert, zip(numbers, blobs[block].tolist(), *values))
        check(0.8)
        _index(database, f"rtree_{table}_{geometry}", boxes)
        low, high = boxes.min(axis=0), boxes.max(axis=0)
        database.execute(
            "UPDATE gpkg_contents SET min_x = ?, max_x = ?, min_y = ?, max_y = ?",
            (low[0], high[1], low[2], high[3]),
        )
        database.execute("UPDATE gpkg_ogr_contents SET feature_count = ?", (len(blobs),))
        for _, sql in triggers:
            database.execute(sql)
        database.commit()
    check(1.0)


def _blobs(polygons, boxes, srs_id):
    blobs = np.empty(len(polygons), BLOB)
    blobs["magic"], blobs["version"], blobs["flags"] = b"GP", 0, LITTLE_ENDIAN_WITH_XY_ENVELOPE
    blobs["srs_id"], blobs["envelope"], blobs["wkb"] = srs_id, boxes, polygons
    return blobs.view(f"V{BLOB.itemsize}")


def _index(database, tree, boxes):
    """Write the nodes of the R-tree ``tree`` from the leaves up; neighbours in space share a node."""
    nodes, rowids, parents = (_quoted(f"{tree}_{kind}") for kind in ("node", "rowid", "parent"))
    size = database.execute(f"SELECT length(data) FROM {nodes} WHERE nodeno = 1").fetchone()[0]
    capacity = (size - 4) // CELL.itemsize
    order = _neighbours(boxes, capacity)
    ids, bounds = order + 1, _outwards(boxes[order])
    depth, unused = 0, 2
    while True:
        count = -(-len(ids) // capacity)
        starts = np.linspace(0, len(ids), count + 1).astype(np.int64)
        numbers = np.array([1]) if count == 1 else np.arange(unused, unused + count)
        cells = np.empty(len(ids), CELL)
        cells["id"], cells["box"] = ids, bounds
        owners = np.repeat(numbers, np.diff(starts))
        table = parents if depth else rowids
        database.executemany(f"INSERT INTO {table} VALUES (?, ?)", zip(ids.tolist(), owners.tolist()))
        is_root = count == 1
        rows = (
            (number, _node(cells[first:end], depth if is_root else 0, size))
            for number, first, end in zip(numbers.tolist(), starts, starts[1:])
        )
        database.executemany(f"INSERT OR REPLACE INTO {nodes} VALUES (?, ?)", rows)
        if is_root:
            return
        low = np.minimum.reduceat(bounds[:, ::2], starts[:-1])
        high = np.maximum.reduceat(bounds[:, 1::2], starts[:-1])
        ids, bounds = numbers, np.stack([low[:, 0], high[:, 0], low[:, 1], high[:, 1]], axis=1)
        depth, unused = depth + 1, unused + count


def _node(cells, depth, size):
    head = depth.to_bytes(2, "big") + len(cells).to_bytes(2, "big")
    return (head + cells.tobytes()).ljust(size, b"\0")


def _neighbours(boxes, capacity):
    """Return an order in which each run of ``capacity`` boxes is compact: columns of tiles, bottom up."""
    x, y = boxes[:, 0] + boxes[:, 1], boxes[:, 2] + boxes[:, 3]
    columns = max(1, round((len(boxes) / capacity) ** 0.5))
    rank = np.empty(len(boxes), np.int64)
    rank[np.argsort(x, kind="stable")] = np.arange(len(boxes))
    return np.lexsort((y, rank * columns // len(boxes)))


def _outwards(boxes):
    """Return the boxes as float32 that hold them."""
    single = boxes.astype(np.float32)
    low, high = single[:, ::2], single[:, 1::2]
    low[low > boxes[:, ::2]] = np.nextafter(low, np.float32(-np.inf))[low > boxes[:, ::2]]
    high[high < boxes[:, 1::2]] = np.nextafter(high, np.float32(np.inf))[high < boxes[:, 1::2]]
    return single


def _quoted(name):
    return '"' + name.replace('"', '""') + '"'
