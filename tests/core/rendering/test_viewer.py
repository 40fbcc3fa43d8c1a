import numpy as np
import pytest
from radiosity.core.rendering.color import linear_to_srgb, srgb_to_linear
from radiosity.core.rendering.framing import fitted_view, framed_view
from radiosity.core.rendering.viewer import ShownScene, View, Viewer
from radiosity.core.visibility.embree import RayEngine, is_available

pytestmark = pytest.mark.skipif(not is_available(), reason="rays need embreex")

X, Y, Z = np.eye(3)


def _quad(corners, colors):
    """A quadrilateral as two triangles with a color (3,) for all, or (4, 3) at its corners."""
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    colors = np.broadcast_to(np.asarray(colors, dtype=np.float32), (4, 3))[triangles]
    return np.asarray(corners, dtype=float), triangles, colors


def _scene(*quads, is_light=True, **options):
    vertices = np.concatenate([vertices for vertices, _, _ in quads])
    triangles = np.concatenate([quads[i][1] + 4 * i for i in range(len(quads))])
    colors = np.concatenate([colors for _, _, colors in quads])
    return ShownScene(vertices, triangles, colors, np.full(len(triangles), is_light), **options)


def _camera(position=(0, 0, 0), half_width=1.0, half_height=1.0, **options):
    """Looks along +Y, X to the right, Z up."""
    return View(np.asarray(position, dtype=float), X, Z, Y, half_width, half_height, **options)


def _wall(depth, half=10.0, colors=(0.5, 0.5, 0.5), x=0.0, z=0.0):
    """Faces -Y, its front to the camera."""
    corners = [(x - half, depth, z - half), (x + half, depth, z - half), (x + half, depth, z + half)]
    return _quad([*corners, (x - half, depth, z + half)], colors)


def _linear(pixels):
    return srgb_to_linear(pixels / 255.0)


def test_colors_are_interpolated_linearly_over_a_triangle():
    corners = np.array([[0.0, 0, 0], [0.48, 0, 0], [0.48, 0.4, 0], [0, 0.4, 0]], dtype=np.float32)
    viewer = Viewer(_scene(_wall(2.0, half=2.0, colors=corners)))
    picture = _linear(viewer.picture(_camera(), 64, 64, exposure=1.0))
    at = (np.arange(64) + 0.5) / 64
    # A bilinear field equals what two triangles interpolate where it is linear; half a step of 8 bits is 1/510 encoded,
    # dithering makes it one step, and the slope of the sRGB curve is at most 1.7 at these values or 12.9 ** -1 below.
    inner = slice(3, -3)
    red, green = np.tile(0.48 * at, (64, 1)), np.tile(0.4 * at[::-1, None], (1, 64))
    np.testing.assert_allclose(picture[inner, inner, 0], red[inner, inner], atol=0.01)
    np.testing.assert_allclose(picture[inner, inner, 1], green[inner, inner], atol=0.01)


@pytest.mark.parametrize("supersampling", [1, 2, 3, 4])
def test_edge_pixel_holds_the_covered_share(supersampling):
    # The wall covers everything left of the middle of pixel column 16.
    wall = _quad([(-30, 1, -30), (1 / 32, 1, -30), (1 / 32, 1, 30), (-30, 1, 30)], (0.4, 0.4, 0.4))
    viewer = Viewer(_scene(wall, background=np.zeros(3)))
    row = _linear(viewer.picture(_camera(), 32, 32, 1.0, supersampling))[16, :, 0]
    np.testing.assert_allclose(row[:15], 0.4, atol=0.01)
    np.testing.assert_allclose(row[18:], 0, atol=0.01)
    if supersampling == 1:
        assert row[16] in (pytest.approx(0.4, abs=0.01), pytest.approx(0, abs=0.01))
    else:
        # The filter is symmetric about the pixel's middle. An odd grid has a column of rays on the very edge.
        assert row[16] == pytest.approx(0.2, abs=0.01 + 0.2 * (supersampling % 2) / supersampling)


def test_nearer_surface_hides_the_farther_one_and_planes_clip():
    scene = _scene(_wall(1.0, colors=(0.6, 0, 0)), _wall(2.0, colors=(0, 0.6, 0)), background=np.array([0, 0, 0.6]))
    viewer = Viewer(scene)
    for options, channel in (({}, 0), ({"near": 1.5}, 1), ({"near": 2.5}, 2), ({"near": 1.5, "far": 1.9}, 2)):
        assert viewer.picture(_camera(**options), 4, 4, 1.0)[2, 2].argmax() == channel


@pytest.mark.parametrize("perspective", [True, False])
def test_depth_is_measured_along_the_axis(perspective):
    viewer = Viewer(_scene(_wall(3.0)))
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(-1, 1, 5), np.linspace(-1, 1, 5)))
    triangles, _, _, depths = viewer.hits(_camera(perspective=perspective), x, y)
    assert (triangles >= 0).all()
    np.testing.assert_allclose(depths, 3, rtol=1e-5)


@pytest.mark.parametrize("perspective", [True, False])
def test_shift_moves_the_window(perspective):
    # A bright column stands where the window's left border is looked through after the shift.
    column = _quad([(0.9, 1, -9), (1.1, 1, -9), (1.1, 1, 9), (0.9, 1, 9)], (0.5, 0.5, 0.5))
    viewer = Viewer(_scene(column))
    view = _camera(center=(2.0, 0.0), perspective=perspective)
    assert viewer.hits(view, np.array([-1.0]), np.array([0.0]))[0][0] >= 0
    assert viewer.hits(_camera(perspective=perspective), np.array([-1.0]), np.array([0.0]))[0][0] == -1


def test_distant_camera_sees_as_a_near_one():
    viewer = Viewer(_scene(_wall(0.0, half=0.5)))
    near = viewer.picture(_camera((0, -10, 0), perspective=False), 40, 40, 1.0)
    far = viewer.picture(_camera((0, -1e6, 0), perspective=False), 40, 40, 1.0)
    np.testing.assert_array_equal(near, far)


def test_picture_is_the_same_in_bands_and_with_any_number_of_threads(monkeypatch):
    colors = np.random.default_rng(6).random((4, 3)).astype(np.float32)
    scene = _scene(_wall(2.0, half=1.3, colors=colors))
    expected = Viewer(scene, threads=1).picture(_camera(), 50, 37)
    monkeypatch.setattr("radiosity.core.rendering.viewer._BAND_SAMPLES", 1000)
    np.testing.assert_array_equal(Viewer(scene, threads=3).picture(_camera(), 50, 37), expected)


def test_same_light_at_another_strength_gives_the_same_picture():
    colors = np.random.default_rng(7).random((4, 3)).astype(np.float32)
    pictures = [
        Viewer(_scene(_wall(2.0, colors=colors * np.float32(factor)))).picture(_camera(), 30, 30)
        for factor in (1, 2.0**-20, 2.0**20)
    ]
    np.testing.assert_array_equal(pictures[1], pictures[0])
    np.testing.assert_array_equal(pictures[2], pictures[0])


def test_what_is_not_light_is_not_exposed():
    scene = _scene(_wall(2.0, colors=(0.2, 0.2, 0.2)), is_light=False)
    picture = Viewer(scene).picture(_camera(), 20, 20, exposure=3.0)
    assert np.abs(picture.astype(float) - 255 * linear_to_srgb(0.2)).max() <= 1


def test_sky_is_seen_in_its_direction():
    # Radiance linear in height: means over cells of equal height are the values at their middles, and interpolation
    # between these gives the function back, but for half a cell at the poles.
    rows, columns = 8, 16
    z = (np.arange(rows) + 0.5) / rows * 2 - 1
    azimuth = (np.arange(columns) + 0.5) / columns * 2 * np.pi
    sky = np.zeros((rows, columns, 3))
    sky[..., 0] = 0.2 + 0.2 * z[:, None]
    sky[..., 1] = 0.2 + 0.2 * np.cos(azimuth)
    # The quad lies behind the camera.
    viewer = Viewer(_scene(_wall(-5.0, half=1.0), background=sky))
    x, y = np.array([-0.9, 0.0, 0.5, 1.0]), np.array([0.3, 0.0, -0.8, 0.5])
    colors, is_light = viewer.colors(_camera(), x, y)
    directions = np.column_stack([x, np.ones(4), y])
    np.testing.assert_allclose(colors[:, 0], 0.2 + 0.2 * y / np.linalg.norm(directions, axis=1), rtol=1e-6)
    # A chord of the cosine over a cell of 22.5 degrees is off by at most 1 - cos(11.25 degrees) of its amplitude.
    np.testing.assert_allclose(colors[:, 1], 0.2 + 0.2 * x / np.hypot(x, 1), atol=0.2 * (1 - np.cos(np.pi / 16)))
    assert not is_light.any()


def test_lamp_edge_is_no_staircase():
    # A lamp a thousand times brighter than white still leaves steps between its edge pixels and the wall.
    lamp = _quad([(-30, 1, -30), (0, 1, -30), (0.2, 1, 30), (-30, 1, 30)], (1000, 1000, 1000))
    viewer = Viewer(_scene(lamp, background=np.zeros(3)))
    rows = viewer.picture(_camera(), 32, 32, 1.0)[:, :, 0].astype(float)
    edge = ((rows > 20) & (rows < 235)).sum(axis=1)
    assert (edge >= 1).mean() > 0.9


def _box(low, high, inward):
    """A box of six quads; normals inwards or outwards."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    sides = [
        [(x0, y0, z0), (x0, y1, z0), (x1, y1, z0), (x1, y0, z0)],
        [(x0, y0, z1), (x1, y0, z1), (x1, y1, z1), (x0, y1, z1)],
        [(x0, y0, z0), (x1, y0, z0), (x1, y0, z1), (x0, y0, z1)],
        [(x0, y1, z0), (x0, y1, z1), (x1, y1, z1), (x1, y1, z0)],
        [(x0, y0, z0), (x0, y0, z1), (x0, y1, z1), (x0, y1, z0)],
        [(x1, y0, z0), (x1, y1, z0), (x1, y1, z1), (x1, y0, z1)],
    ]
    return [_quad(side[::-1] if inward else side, (0.5, 0.5, 0.5)) for side in sides]


def test_room_seen_from_outside_opens_to_its_far_side():
    viewer = Viewer(_scene(*_box((-1, 2, -1), (1, 4, 1), inward=True)))
    view = viewer.opened(_camera(half_width=0.2, half_height=0.2))
    assert view.skips_backs
    *_, depths = viewer.hits(view, np.zeros(1), np.zeros(1))
    assert depths[0] == pytest.approx(4, rel=1e-5)


@pytest.mark.parametrize("inward", [True, False])
def test_room_seen_from_inside_stays_closed(inward):
    viewer = Viewer(_scene(*_box((-1, -1, -1), (1, 1, 1), inward)))
    assert not viewer.opened(_camera()).skips_backs


@pytest.mark.parametrize("numbers", [(0, 10, 3), (10, 0, 3), (10, 10, 0)])
def test_empty_picture_is_refused(numbers):
    viewer = Viewer(_scene(_wall(1.0)))
    with pytest.raises(ValueError, match="No picture"):
        viewer.picture(_camera(), numbers[0], numbers[1], 1.0, numbers[2])


@pytest.mark.parametrize("scale", [1e-5, 1.0, 1e5])
@pytest.mark.parametrize("aspect", [0.5, 1.0, 16 / 9])
def test_fitted_view_holds_all_points_and_touches_the_margin(scale, aspect):
    generator = np.random.default_rng(8)
    points = scale * (generator.normal(size=(200, 3)) * (3, 1, 0.5) + 7)
    view = fitted_view(points, generator.normal(size=3), aspect)
    local = points - view.position
    depth = local @ view.forward
    x = local @ view.right / depth / view.half_width
    y = local @ view.up / depth / view.half_height
    assert (depth > 0).all()
    reach = max(np.abs(x).max(), np.abs(y).max())
    assert reach == pytest.approx(1 / 1.04, rel=1e-9)


def _framed(quads, aspect=16 / 9):
    scene = _scene(*quads)
    return framed_view(RayEngine(scene.vertices, scene.triangles), scene.vertices, scene.triangles, aspect)


@pytest.mark.parametrize("scale", [1e-5, 1.0, 1e5])
@pytest.mark.parametrize("inward", [True, False])
def test_closed_room_is_seen_from_inside(inward, scale):
    low, high = scale * np.array([1.0, 2, 0]), scale * np.array([6.0, 6, 3])
    view = _framed(_box(low, high, inward))
    assert (view.position > low).all() and (view.position < high).all()


@pytest.mark.parametrize("side", range(2, 6))
def test_room_with_a_missing_wall_is_seen_through_it(side):
    quads = _box((0, 0, 0), (4, 4, 3), inward=True)
    missing = quads.pop(side)[0].mean(axis=0)
    view = _framed(quads)
    outwards = missing - np.array([2, 2, 1.5])
    assert view.forward @ outwards / np.linalg.norm(outwards) == pytest.approx(-1, abs=1e-9)
    assert (view.position - missing) @ outwards > 0


def test_object_in_the_open_is_seen_from_above_and_outside():
    ground = _quad([(-50, -50, 0), (50, -50, 0), (50, 50, 0), (-50, 50, 0)], (0.5, 0.5, 0.5))
    view = _framed([ground, *_box((-1, -1, 0), (1, 1, 2), inward=False)])
    assert view.position[2] > 2
    assert view.forward[2] < -0.4
    # Framed on the box, not on the ground around it.
    assert np.linalg.norm(view.position) < 20


def test_view_is_not_inside_a_solid():
    pillar = ((0.5, 0.5, 0), (3.5, 3.5, 3))
    view = _framed([*_box((0, 0, 0), (10, 4, 3), inward=True), *_box(*pillar, inward=False)])
    low, high = np.array(pillar)
    assert not ((view.position > low) & (view.position < high)).all()
