"""Random places: crowded halls, a street, a car park, a museum; and pits, galleries and platforms that no way joins."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gpdf_service.synthetic.furniture import bed, bounds_in_plan, chair, cupboard, person, random_piece, table
from gpdf_service.synthetic.houses import house
from gpdf_service.synthetic.place import Place
from gpdf_service.synthetic.solid_world import SolidWorld
from gpdf_service.synthetic.solids import Solid, board, box, post, prism, turn_and_shift
from gpdf_service.synthetic.stairs import STAIRS, Layout, Stair, Style
from gpdf_service.types import FloatArray

Size = tuple[float, float]


def rectangle(low: Size, high: Size, z: float) -> FloatArray:
    """Corners of a level rectangle in order, (4, 3) [m]."""
    return np.array([(low[0], low[1], z), (high[0], low[1], z), (high[0], high[1], z), (low[0], high[1], z)])


def hall(size: Size, height: float, *, ceiling: bool = True) -> list[Solid]:
    """A floor with walls around it, and a ceiling."""
    x, y = size
    made = [box("floor", (0, 0, -0.2), (x, y, 0), walkable=True)]
    sides = [((-0.2, -0.2), (0, y + 0.2)), ((x, -0.2), (x + 0.2, y + 0.2)), ((0, -0.2), (x, 0)), ((0, y), (x, y + 0.2))]
    made += [box("wall", (*low, -0.2), (*high, height)) for low, high in sides]
    return made + ([box("ceiling", (-0.2, -0.2, height), (x + 0.2, y + 0.2, height + 0.2))] if ceiling else [])


def _one_floor(name: str, solids: list[Solid], size: Size, rng: np.random.Generator) -> Place:
    """A place of one floor, turned by a random angle."""
    room = rectangle((0.0, 0.0), size, 0.0)
    middle = np.array([[0.5 * size[0], 0.5 * size[1], 0.0]])
    made = _turned(Place(name, SolidWorld(tuple(solids)), (room,), middle), rng)
    home = made.free_places(0, 1, rng)
    return Place(name, made.world, made.rooms, home if len(home) else made.way)


def _turned(place: Place, rng: np.random.Generator) -> Place:
    T = turn_and_shift(float(rng.uniform(-np.pi, np.pi)), rng.uniform(-5.0, 5.0, 3))

    def moved(points: FloatArray) -> FloatArray:
        made: FloatArray = points @ T[:3, :3].T + T[:3, 3]
        return made

    rooms, islands = (tuple(moved(corners) for corners in many) for many in (place.rooms, place.islands))
    return Place(place.name, place.world.moved(T), rooms, moved(place.way), moved(place.landings), islands)


def _scatter(
    make: Callable[[float, float], list[Solid]], count: int, size: Size, rng: np.random.Generator
) -> list[Solid]:
    """Things at random places of a floor, none through another."""
    made: list[Solid] = []
    taken: list[tuple[FloatArray, FloatArray]] = []
    for x, y in rng.uniform([0.3, 0.3], np.array(size) - 0.5, (count, 2)):
        piece = make(float(x), float(y))
        low, high = bounds_in_plan(piece)
        clear = all((high < a - 0.05).any() or (low > b + 0.05).any() for a, b in taken)
        if clear and (high < size).all() and (low > 0).all():
            made += piece
            taken.append((low, high))
    return made


def library(rng: np.random.Generator) -> Place:
    """Shelves up to 2.2 m in rows, with aisles as wide as a wheelchair needs, and tables to read at."""
    x, y, aisle = 12.0, 9.0, float(rng.uniform(0.95, 1.4))
    solids = hall((x, y), float(rng.uniform(2.8, 3.6)))
    for x0 in np.arange(1.2, x - 4.0, 0.35 + aisle):
        for y0, y1 in ((1.2, 4.2), (5.2, y - 0.3)):
            solids.append(box("shelf", (x0, y0, 0), (x0 + 0.35, y1, float(rng.uniform(1.6, 2.2)))))
    solids += table((x - 2.5, 1.0, 0), (1.8, 0.9)) + table((x - 2.5, 5.0, 0), (1.8, 0.9)) + chair((x - 1.8, 2.1, 0))
    return _one_floor("library", solids, (x, y), rng)


def supermarket(rng: np.random.Generator) -> Place:
    """Gondolas of boards, one over the other, with goods on them, and cash desks."""
    x, y = 14.0, 10.0
    solids = hall((x, y), 3.6)
    for x0 in np.arange(1.5, x - 2.0, 2.3):
        solids.append(box("shelf", (x0 + 0.45, 1.5, 0), (x0 + 0.5, y - 3.0, 1.6)))
        solids += [box("shelf", (x0, 1.5, z), (x0 + 0.95, y - 3.0, z + 0.04)) for z in (0.12, 0.5, 0.9, 1.3)]
        for y0 in np.arange(1.6, y - 3.4, 0.45):
            z = float(rng.choice([0.16, 0.54, 0.94, 1.34]))
            solids.append(box("goods", (x0 + 0.05, y0, z), (x0 + 0.4, y0 + 0.3, z + float(rng.uniform(0.1, 0.3)))))
    solids += [box("desk", (x0, y - 1.9, 0), (x0 + 0.6, y - 0.4, 0.9)) for x0 in np.arange(2.0, x - 1.0, 1.7)]
    return _one_floor("supermarket", solids, (x, y), rng)


def storage(rng: np.random.Generator) -> Place:
    """Racks of posts and beams, and boxes of any height on the floor."""
    x, y = 11.0, 9.0
    solids = hall((x, y), 4.5)
    for x0 in np.arange(0.1, x - 1.0, 3.2):
        for z in (0.15, 1.6, 3.0):
            solids.append(box("rack", (x0, 1.5, z), (x0 + 0.9, y - 1.5, z + 0.1)))
        feet = [(x0 + dx, float(y0)) for dx in (0.03, 0.87) for y0 in np.linspace(1.55, y - 1.55, 4)]
        solids += [post("rack", (*foot, 0.0), 0.04, 3.6, 8) for foot in feet]

    def crate(a: float, b: float) -> list[Solid]:
        return cupboard((a, b, 0.0), tuple(rng.uniform([0.3, 0.3, 0.1], [0.9, 0.8, 1.3]).tolist()))

    return _one_floor("storage", solids + _scatter(crate, 10, (x, y), rng), (x, y), rng)


def workshop(rng: np.random.Generator) -> Place:
    """Benches, machines, pipes under the ceiling, and lids: plates 5 to 20 cm over the floor on four feet."""
    x, y = 10.0, 8.0
    solids = hall((x, y), 3.4)
    solids += [box("pipe", (0, y0, 2.7), (x, y0 + 0.15, 2.85)) for y0 in (1.3, 4.2)]

    def thing(a: float, b: float) -> list[Solid]:
        if rng.random() < 0.3:
            return table((a, b, 0.0), (0.9, 0.7), float(rng.uniform(0.08, 0.2)))
        return random_piece((a, b, 0.0), rng)

    return _one_floor("workshop", solids + _scatter(thing, 18, (x, y), rng), (x, y), rng)


def bedroom(rng: np.random.Generator) -> Place:
    """A room full of beds, tables and lids under a low ceiling."""
    size = (float(rng.uniform(5.0, 7.0)), float(rng.uniform(4.5, 6.0)))
    solids = hall(size, float(rng.uniform(2.4, 2.7)))

    def thing(a: float, b: float) -> list[Solid]:
        corner, kind = (a, b, 0.0), rng.integers(3)
        return (bed(corner), table(corner, (1.0, 0.7)), table(corner, (0.8, 0.6), float(rng.uniform(0.1, 0.2))))[kind]

    return _one_floor("bedroom", solids + _scatter(thing, 14, size, rng), size, rng)


def market(rng: np.random.Generator) -> Place:
    """Stalls with roofs on posts, crates, and people, under the sky."""
    size = (12.0, 10.0)

    def stall(a: float, b: float) -> list[Solid]:
        feet = [(a + dx, b + dy, 0.0) for dx in (0.05, 1.75) for dy in (0.05, 1.15)]
        roof = box("roof", (a, b, 2.25), (a + 1.8, b + 1.2, 2.29))
        return [roof, *table((a + 0.2, b + 0.2, 0.0), (1.4, 0.7)), *(post("stall", f, 0.02, 2.25, 8) for f in feet)]

    def thing(a: float, b: float) -> list[Solid]:
        kind = rng.random()
        if kind < 0.4:
            return stall(a, b)
        return person((a, b, 0.0), float(rng.uniform(1.5, 1.9))) if kind < 0.7 else cupboard((a, b, 0), (0.6, 0.4, 0.3))

    floor = [box("floor", (0, 0, -0.2), (*size, 0), walkable=True)]
    return _one_floor("market", floor + _scatter(thing, 40, size, rng), size, rng)


def hedge(rng: np.random.Generator) -> Place:
    """Lawn between two hedges of leaves, with a few trunks."""
    size = (12.0, 7.0)
    solids = [box("floor", (0, 0, -0.2), (*size, 0), walkable=True)]
    for y0 in (1.0, 5.0):
        for x, y, z in rng.uniform((0.5, y0, 0.02), (11.5, y0 + 0.8, 1.5), (900, 3)):
            solids.append(box("leaf", (x, y, z), (x + 0.06, y + 0.05, z + 0.01)))
    solids += [post("trunk", (float(x), 3.2, 0.0), 0.15, 4.0) for x in (3.0, 8.5)]
    return _one_floor("hedge", solids, size, rng)


def crowd(rng: np.random.Generator) -> Place:
    """A hall full of people who stand."""
    size = (10.0, 8.0)

    def someone(a: float, b: float) -> list[Solid]:
        return person((a, b, 0.0), float(rng.uniform(1.2, 1.95)))

    return _one_floor("crowd", hall(size, 3.5) + _scatter(someone, 40, size, rng), size, rng)


def street(rng: np.random.Generator) -> Place:
    """A road between two pavements 12 cm higher, cars, lamp posts, and fronts of houses with a step before the door."""
    size, kerb = (24.0, 12.0), 0.12
    solids = [box("floor", (0, 2.5, -0.3), (24, 9.5, -kerb), walkable=True)]
    solids += [box("floor", (0, y0, -0.3), (24, y1, 0), walkable=True) for y0, y1 in ((0.0, 2.5), (9.5, 12.0))]
    solids += [box("wall", (0, y0, -0.3), (24, y1, 6.0)) for y0, y1 in ((-0.3, 0.0), (12.0, 12.3))]
    solids += [box("step", (float(x), 0.0, 0.0), (float(x) + 1.2, 0.5, 0.16), walkable=True) for x in (3.0, 12.0)]
    for x in rng.choice(np.arange(1.0, 19.0, 5.0), 3, replace=False):
        y = float(rng.choice([2.8, 7.4]))
        solids.append(box("car", (float(x), y, 0.08), (float(x) + 4.2, y + 1.7, 0.75)))
        solids.append(box("car", (float(x) + 1.0, y + 0.1, 0.75), (float(x) + 3.4, y + 1.6, 1.35)))
        wheels = [(x + dx, y + dy, -kerb) for dx in (0.8, 3.4) for dy in (0.2, 1.5)]
        solids += [post("car", wheel, 0.12, 0.4, 8) for wheel in wheels]
    solids += [post("lamp", (float(x), 2.2, 0.0), 0.06, 5.0, 8) for x in (2.0, 10.0, 18.0)]
    return _one_floor("street", solids, (size[0], 2.4), rng)


def car_park(rng: np.random.Generator) -> Place:
    """Two decks that a ramp joins, with columns, parapets and cars."""
    rise, slab, foot, head = float(rng.uniform(2.7, 3.0)), 0.25, 2.5, 22.0
    solids = [box("floor", (0, 0, -0.2), (14, 24, 0), walkable=True)]
    outline = [(0.0, foot), (3.5, foot), (3.5, head), (0.0, head)]
    solids.append(prism("ramp", outline, -0.1, [0.0, 0.0, rise, rise], walkable=True))
    solids += [
        box("floor", (*low, rise - slab), (*high, rise), walkable=True)
        for low, high in (((3.5, 0.0), (14.0, 24.0)), ((0.0, head), (3.5, 24.0)))
    ]
    solids.append(board("parapet", (3.55, foot, rise), (3.55, head, rise), 0.1, 0.0, 1.0))
    solids += [box("wall", low, high) for low, high in (((-0.2, 0, 0), (0, 24, 4)), ((14, 0, 0), (14.2, 24, 4)))]
    solids += [box("column", (x, y, 0), (x + 0.3, y + 0.3, rise - slab)) for x in (4.5, 9.5) for y in (6.0, 12.0, 18.0)]
    for z in (0.0, rise):
        for y in rng.choice(np.arange(1.0, 21.0, 2.6), 4, replace=False):
            solids.append(box("car", (9.9, float(y), z + 0.2), (13.9, float(y) + 1.7, z + 1.3)))
    rooms = (rectangle((4.0, 0.5), (13.5, 23.5), 0.0), rectangle((4.0, 0.5), (13.5, 23.5), rise))
    way = np.array([(6, 1.2, 0), (1.75, 1.2, 0), (1.75, foot, 0), (1.75, head, rise), (1.75, 23, rise), (6, 23, rise)])
    return _turned(Place("car_park", SolidWorld(tuple(solids)), rooms, way), rng)


def museum(rng: np.random.Generator) -> Place:
    """A high hall with a flight up to a gallery along one side, which has a parapet."""
    rise, going, width, treads = float(rng.uniform(0.17, 0.2)), float(rng.uniform(0.22, 0.3)), 1.3, 21
    style = Style(rise, going, width, under=str(rng.choice(["massive", "soffit"])), boards=("left", "right"))
    stair = Stair("straight", style, tuple(Layout(width, going).straight(treads).treads))
    length, deck = treads * going, stair.storey
    T = turn_and_shift(0.0, (2.5, 4.0, 0.0))
    size = (2.5 + length + 2.5, 9.0)
    solids = [*hall(size, deck + 3.0), *(solid.moved(T) for solid in stair.solids())]
    solids.append(box("floor", (2.5 + length, 0, deck - 0.3), (*size, deck), walkable=True))
    ends = ((0.0, 4.0 - 0.7), (4.0 + 0.7, size[1]))
    solids += [box("parapet", (2.5 + length, a, deck), (2.6 + length, b, deck + 1.0)) for a, b in ends]
    solids += [box("vitrine", (float(x), 6.5, 0), (float(x) + 0.6, 7.1, 1.2)) for x in (1.5, 4.0)]
    rooms = (rectangle((0, 0), size, 0.0), rectangle((2.7 + length, 0.1), (size[0] - 0.1, size[1] - 0.1), deck))
    way = stair.way() + T[:3, 3]
    return _turned(Place("museum", SolidWorld(tuple(solids)), rooms, way), rng)


def pit(rng: np.random.Generator) -> Place:
    """A hall with a pit that nobody steps into: 0.6 to 1.2 m deep, 3 to 4 m wide."""
    wide, deep = rng.uniform(3.0, 4.0, 2), float(rng.uniform(0.6, 1.2))
    return _hall_with_hole("pit", np.array([3.0, 2.5]), wide, deep, rng)


def shaft(rng: np.random.Generator) -> Place:
    """A hall with a shaft of which a scanner sees walls alone: 1.2 to 3 m deep, 0.45 to 1.1 m wide."""
    wide, deep = rng.uniform(0.45, 1.1, 2), float(rng.uniform(1.2, 3.0))
    return _hall_with_hole("shaft", rng.uniform([2.0, 1.5], [6.0, 5.5]), wide, deep, rng)


def _hall_with_hole(name: str, corner: FloatArray, wide: FloatArray, deep: float, rng: np.random.Generator) -> Place:
    size, (x0, y0), (x1, y1) = (9.0, 8.0), corner.tolist(), (corner + wide).tolist()
    solids = [solid for solid in hall(size, 3.5) if solid.kind != "floor"]
    parts = [((0, 0), (9, y0)), ((0, y1), (9, 8)), ((0, y0), (x0, y1)), ((x1, y0), (9, y1))]
    solids += [box("floor", (*low, -deep - 0.2), (*high, 0), walkable=True) for low, high in parts]
    solids.append(box("floor", (x0, y0, -deep - 0.2), (x1, y1, -deep), walkable=True))
    return _with_island(name, solids, size, rectangle((x0, y0), (x1, y1), -deep), rng)


def gallery(rng: np.random.Generator) -> Place:
    """A hall with a gallery 2.6 to 3.2 m up, behind a parapet, that no stair in the scan leads to."""
    size, high = (9.0, 8.0), float(rng.uniform(2.6, 3.2))
    solids = hall(size, high + 2.6)
    solids.append(box("floor", (0, 5.2, high - 0.25), (9, 8, high), walkable=True))
    solids.append(box("parapet", (0, 5.2, high), (9, 5.3, high + 0.9)))
    return _with_island("gallery", solids, size, rectangle((0, 5.3), size, high), rng, scanned=True)


def platform(rng: np.random.Generator) -> Place:
    """A platform 0.55 to 1.0 m over the bed of a track with two rails."""
    high = float(rng.uniform(0.55, 1.0))
    solids = [box("floor", (0, 0, -high - 0.3), (14, 4, 0), walkable=True)]
    solids.append(box("floor", (0, 4, -high - 0.3), (14, 7, -high), walkable=True))
    solids += [box("rail", (0, y, -high), (14, y + 0.07, -high + 0.15)) for y in (4.8, 6.2)]
    solids.append(box("wall", (0, 7, -high - 0.3), (14, 7.2, 3.0)))
    solids += [post("column", (x, 1.5, 0.0), 0.15, 3.5) for x in (3.0, 8.0)]
    return _with_island("platform", solids, (14.0, 4.0), rectangle((0, 4.9), (14, 6.2), -high), rng)


def _with_island(
    name: str, solids: list[Solid], size: Size, island: FloatArray, rng: np.random.Generator, *, scanned: bool = False
) -> Place:
    floor = rectangle((0.0, 0.0), size, 0.0)
    rooms = (floor, island) if scanned else (floor,)
    way = np.array([[1.0, 1.0, 0.0]])
    return _turned(Place(name, SolidWorld(tuple(solids)), rooms, way, islands=(island,)), rng)


def roofs(rng: np.random.Generator) -> Place:
    """Huts with flat or inclined roofs, lower and higher than a person, on a lawn."""
    size = (16.0, 12.0)

    def hut(a: float, b: float) -> list[Solid]:
        (w, d), z = rng.uniform(2.0, 4.0, 2), float(rng.uniform(0.8, 3.0))
        outline = [(a, b), (a + w, b), (a + w, b + d), (a, b + d)]
        top = z + np.array([0.0, 0.0, 1.0, 1.0]) * float(rng.choice([0.0, 0.5, 1.0]))
        return [prism("roof", outline, 0.0, top)]

    floor = [box("floor", (0, 0, -0.2), (*size, 0), walkable=True)]
    return _one_floor("roofs", floor + _scatter(hut, 10, size, rng), size, rng)


Maker = Callable[[np.random.Generator], Place]


def _house_maker(kind: str) -> Maker:
    return lambda rng: house(rng, kind)


ONE_FLOOR = (library, supermarket, storage, workshop, bedroom, market, hedge, crowd, street, roofs)
"""Places where all that is walked on is one floor, among much that is none."""
ISLANDS = (pit, gallery, platform)
"""Places with ground that no way leads to."""
PLACES: dict[str, Maker] = {
    "house": house,
    **{f"house_{kind}": _house_maker(kind) for kind in STAIRS},
    **{make.__name__: make for make in (*ONE_FLOOR, car_park, museum, *ISLANDS, shaft)},
}
"""Places by name: each is made from a random generator."""
