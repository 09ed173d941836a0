import numpy as np
import pytest
import shapely

from sim.cities import CitySplit, CityStyle, random_city

SOME = range(25)


def straight_rate(cities, rng, count=300):
    """Return the share of straight flights between free points that touch nothing."""
    rates = []
    for city in cities:
        points = rng.uniform(0.0, city.size_m, (6 * count, 3))
        points = points[city.is_free(points)][: 2 * count]
        half = len(points) // 2
        depth_m = city.obstacles.crash_depth_m(points[:half], points[half : 2 * half])
        rates.append(np.mean(depth_m == 0.0))
    return float(np.mean(rates))


def test_the_same_city_for_ever():
    one, same = random_city("training", 7), random_city(CitySplit.TRAINING, 7)
    assert one.content_hash == same.content_hash
    assert one.name == "training-7"
    np.testing.assert_array_equal(one.launch_enu_m, same.launch_enu_m)


def test_no_city_is_in_two_splits():
    hashes = [random_city(split, number).content_hash for split in CitySplit for number in SOME]
    assert len(set(hashes)) == len(hashes)


@pytest.mark.parametrize("split", CitySplit)
def test_cities_are_flyable_and_varied(split):
    cities = [random_city(split, number) for number in SOME]
    for city in cities:
        assert city.is_free(city.launch_enu_m)
        assert city.obstacles.signed_distance_m(city.launch_enu_m) > 2.0
        assert city.launch_enu_m[2] == 0.0
        assert len(city.obstacles) >= 4
    heights_m = np.concatenate([city.heights_m for city in cities])
    assert heights_m.min() < 25.0
    assert heights_m.max() > 90.0
    concave = [
        shapely.Polygon(outline).convex_hull.area - shapely.Polygon(outline).area > 1.0
        for city in cities
        for outline in city.footprints_m
    ]
    assert 0.2 < np.mean(concave) < 0.8, "courtyards and corners among the rest"


def test_buildings_do_not_overlap():
    style = CityStyle()
    for number in SOME:
        city = random_city("training", number, style)
        outlines = [shapely.Polygon(outline) for outline in city.footprints_m]
        for i, one in enumerate(outlines):
            for other in outlines[i + 1 :]:
                assert one.intersection(other).area < 1e-9


def test_flying_straight_is_no_answer():
    cities = [random_city("test", number) for number in SOME]
    assert 0.3 < straight_rate(cities, np.random.default_rng(0)) < 0.65


def test_density_and_height_make_it_harder():
    def rate(**style):
        cities = [random_city("test", number, CityStyle(**style)) for number in SOME]
        return straight_rate(cities, np.random.default_rng(0))

    assert rate(density=0.3) > rate() + 0.1
    assert rate(height_m=(5.0, 20.0)) > rate() + 0.1
    assert random_city("test", 0, CityStyle(density=0.0)).heights_m.size == 0


def test_other_sizes():
    style = CityStyle(size_m=(300.0, 200.0, 60.0), height_m=(5.0, 50.0))
    city = random_city("validation", 3, style)
    np.testing.assert_array_equal(city.size_m, [300.0, 200.0, 60.0])
    assert len(city.obstacles) > 20


@pytest.mark.parametrize(
    ("style", "message"),
    [
        ({"street_m": (5.0, 4.0)}, "street_m"),
        ({"block_m": (2.0, 4.0)}, "blocks"),
        ({"height_m": (5.0, 150.0)}, "ceiling"),
        ({"density": 1.5}, "density"),
        ({"tower_share": 0.6, "court_share": 0.6}, "shares"),
    ],
    ids=lambda value: value if isinstance(value, str) else None,
)
def test_impossible_styles_are_refused(style, message):
    with pytest.raises(ValueError, match=message):
        CityStyle(**style)
