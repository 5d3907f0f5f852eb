"""Detectors of others: tiny ONNX networks with known output, in each layout, recognised and read."""

import json
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from support.networks import CARS, NAMES, TRUTH, mmrotate, network, nms_free, raw

import orthoscale
from orthoscale.core.boxes import Boxes
from orthoscale.core.detections import Detections, Tile
from orthoscale.core.measuring.measure import measure
from orthoscale.core.measuring.method import Method
from orthoscale.core.measuring.plan import PlanGeometry
from orthoscale.core.ruler import Ruler
from orthoscale.detect import foreign, workers
from orthoscale.detect.cache import TileCache
from orthoscale.detect.detector import MOST_BOXES, Detector
from orthoscale.detect.sweep import sweep_twice
from orthoscale.detect.tiles import Looks, look_twice
from orthoscale.errors import InputError, OrthoscaleError, UsageError
from orthoscale.fleets import load_fleet
from orthoscale.formats.detections.classes import is_vehicle, vehicle_numbers
from orthoscale.formats.tables import standards
from orthoscale.photos.depth.network import DepthNetwork
from orthoscale.photos.depth.rules import RULES

onnx = pytest.importorskip("onnx")
helper, numpy_helper = onnx.helper, onnx.numpy_helper


def found(path, size=(128, 128), **options):
    detector = Detector(path, **options)
    boxes = detector(np.zeros((*size, 3), np.uint8))
    return detector, boxes[np.argsort(-boxes.score)]


@pytest.mark.parametrize("open_shapes", [False, True])
@pytest.mark.parametrize(
    "decoder, outputs, metadata",
    [
        ("ultralytics", {"output0": raw()}, NAMES),
        ("ultralytics-nms-free", {"output0": nms_free()}, {**NAMES, "end2end": "True"}),
        ("mmrotate", mmrotate(), {}),
    ],
)
def test_layouts_are_recognised_and_read(tmp_path, decoder, outputs, metadata, open_shapes):
    path = network(tmp_path / "theirs.onnx", outputs, metadata, open_shapes=open_shapes)
    detector, cars = found(path)
    assert detector.layout.decoder == decoder
    assert cars.xylwa == pytest.approx(np.array(CARS), abs=1e-5)
    assert cars.score == pytest.approx([0.9, 0.8])
    assert len(detector(np.zeros((128, 128, 3), np.uint8), threshold=0.1)) == 3, "the doubtful one as well"
    assert decoder in detector.card.name


@pytest.mark.slow
@pytest.mark.parametrize(
    "decoder, outputs, metadata",
    [
        ("ultralytics", {"out": raw()}, NAMES),
        ("ultralytics-nms-free", {"out": nms_free()}, NAMES),
        ("mmrotate", mmrotate(), {}),
        ("rtmdet", mmrotate(), {}),
    ],
)
def test_layouts_by_name(tmp_path, decoder, outputs, metadata):
    detector, cars = found(network(tmp_path / "a.onnx", outputs, metadata), decoder=decoder)
    assert detector.layout.decoder == decoder and len(cars) == 2
    with pytest.raises(InputError, match="not those that the decoder 'orthoscale' reads"):
        Detector(tmp_path / "a.onnx", decoder="orthoscale")
    with pytest.raises(UsageError, match="no decoder is called 'yolo'"):
        Detector(tmp_path / "a.onnx", decoder="yolo")


def test_seven_by_seven_is_told_by_the_metadata(tmp_path):
    two = {"names": "{0: 'large vehicle', 1: 'small vehicle'}", "task": "obb"}
    seven = np.zeros((1, 7, 7))
    for layout, extra in (("ultralytics", {}), ("ultralytics-nms-free", {"args": "{'nms': True, 'half': False}"})):
        path = network(tmp_path / f"{layout}.onnx", {"output0": seven}, {**two, **extra})
        assert Detector(path).layout.decoder == layout


def test_what_decides_over_boxes_is_in_the_layouts_text(tmp_path):
    """Kept looks are found again by it, in another process too."""
    path = network(tmp_path / "a.onnx", {"output0": raw()}, NAMES)
    cars, buses = (repr(Detector(path, vehicle_classes=classes).layout) for classes in ([], ["large vehicle"]))
    assert cars != buses and " at 0x" not in cars + repr(Detector().layout)


def test_padding_and_overflow_are_no_boxes(tmp_path):
    rows = nms_free()
    rows[0, 4:] = [[50, 50, 0, 10, 0.9, 1, 0], [50, 50, np.nan, 10, 0.9, 1, 0], [np.inf, 50, 30, 10, 0.9, 1, 0]]
    assert len(found(network(tmp_path / "a.onnx", {"output0": rows}, NAMES))[1]) == 2


def test_half_precision_networks(tmp_path):
    path = network(tmp_path / "half.onnx", {"output0": raw()}, NAMES, dtype=onnx.TensorProto.FLOAT16)
    assert found(path)[1].xylwa == pytest.approx(np.array(CARS), abs=0.02)


def test_class_names_decide(tmp_path):
    path = network(tmp_path / "a.onnx", {"output0": raw()}, {**NAMES, "names": "{0: 'Bus', 1: 'Cars', 2: 'ship'}"})
    assert len(found(path)[1]) == 2
    ((bus,),) = (found(path, vehicle_classes=["bus"])[1].xylwa,)
    assert bus[2] == pytest.approx(90)
    assert len(found(path, vehicle_classes=["bus", "1"])[1]) == 3
    boats = network(tmp_path / "b.onnx", {"output0": raw()}, {**NAMES, "names": "{0: 'ship', 1: 'plane', 2: 'dock'}"})
    with pytest.raises(InputError, match=r"b\.onnx: no class whose name means small vehicles among ship, plane, dock"):
        Detector(boats)
    with pytest.raises(InputError, match="no class called lorry"):
        Detector(boats, vehicle_classes=["lorry"])


@pytest.mark.parametrize(
    "name, counts",
    [("small-vehicle", True), ("Small_Car", True), ("CARS", True), ("pickup truck", True), ("large-vehicle", False)]
    + [("cargo truck", False), ("train car wagon", False), ("", False)],
)
def test_which_names_are_vehicles(name, counts):
    assert is_vehicle(name) == counts
    assert vehicle_numbers(["ship", name]) == ([1] if counts else [])


def test_nameless_classes_need_a_number(tmp_path):
    path = network(tmp_path / "a.onnx", {"output0": raw()}, {"task": "obb"})
    with pytest.raises(UsageError, match="it has no names of its classes") as caught:
        Detector(path)
    assert "by number, 0 to 2: --vehicle-class NUMBER" in caught.value.hint, "10 is right for DOTA's alone"
    assert len(found(path, vehicle_classes=["1"])[1]) == 2
    path = network(tmp_path / "b.onnx", mmrotate(large=3, small=18))
    assert len(found(path, vehicle_classes=["18"])[1]) == 2, "DIOR has more classes than DOTA"


def bright(path, std, mean):
    """A network that boxes what is exactly the colour (200, 100, 50) after its normalisation; one box of score 1."""
    colour = (np.array([200, 100, 50]) - mean) / std
    weights = [
        numpy_helper.from_array(colour.astype(np.float32).reshape(1, 3, 1, 1), "colour"),
        numpy_helper.from_array(np.array([[[50, 50, 30, 12, 0, 0]]], np.float32), "box"),
        numpy_helper.from_array(np.array([[[0, 0, 0, 0, 0, 1]]], np.float32), "one"),
        numpy_helper.from_array(np.array([[4]]), "labels_known"),
        numpy_helper.from_array(np.float32(1e-3), "small"),
    ]
    nodes = [
        helper.make_node("Sub", ["images", "colour"], ["d"]),
        helper.make_node("Abs", ["d"], ["distance"]),
        helper.make_node("ReduceMax", ["distance"], ["farthest_channel"], axes=[1], keepdims=0),
        helper.make_node("ReduceMin", ["farthest_channel"], ["nearest"], keepdims=0),
        helper.make_node("Less", ["nearest", "small"], ["hit"]),
        helper.make_node("Cast", ["hit"], ["score"], to=1),
        helper.make_node("Mul", ["one", "score"], ["last"]),
        helper.make_node("Add", ["box", "last"], ["dets"]),
        helper.make_node("Identity", ["labels_known"], ["labels"]),
    ]
    graph = helper.make_graph(
        nodes,
        "bright",
        [helper.make_tensor_value_info("images", 1, [1, 3, "h", "w"])],
        [helper.make_tensor_value_info("dets", 1, [1, 1, 6]), helper.make_tensor_value_info("labels", 7, [1, 1])],
        weights,
    )
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), path)
    return path


def test_the_image_is_normalised_as_each_decoder_wants_it(tmp_path):
    image = np.zeros((96, 96, 3), np.uint8)
    image[10, 10] = (200, 100, 50)
    rgb = bright(tmp_path / "rgb.onnx", np.array([58.395, 57.12, 57.375]), np.array([123.675, 116.28, 103.53]))
    assert len(Detector(rgb)(image)) == 1
    assert len(Detector(rgb, decoder="rtmdet")(image)) == 0
    image[10, 10] = (50, 100, 200)  # BGR
    bgr = bright(tmp_path / "bgr.onnx", np.array([57.375, 57.12, 58.395]), np.array([103.53, 116.28, 123.675]))
    assert len(Detector(bgr, decoder="rtmdet")(image)) == 1
    assert "ImageNet" in Detector(bgr).card.name, "what was taken for granted is said"


def test_mmdeploys_pipeline_file_is_believed(tmp_path):
    image = np.zeros((96, 96, 3), np.uint8)
    image[10, 10] = (50, 100, 200)
    path = bright(tmp_path / "end2end.onnx", np.array([2.0, 3, 4]), np.array([1.0, 2, 3]))
    assert len(Detector(path)(image)) == 0
    step = {"type": "Normalize", "mean": [1, 2, 3], "std": [2, 3, 4], "to_rgb": False}
    pipeline = {
        "pipeline": {"tasks": [{"module": "Transform", "transforms": [{"type": "Pad"}, step]}, {"module": "Net"}]}
    }
    (tmp_path / "pipeline.json").write_text(json.dumps(pipeline))
    assert len(Detector(path)(image)) == 1
    (tmp_path / "pipeline.json").write_text('{"pipeline": {"tasks": [{"transforms": [{"type": "Normalize"}]}]}}')
    with pytest.raises(InputError, match=r"pipeline\.json"):
        Detector(path)


def test_an_input_of_one_size_is_moved_over_the_image(tmp_path):
    """The network gives the same boxes wherever it looks; each window's are there, but those its inner edges cut."""
    boxes = raw().copy()
    boxes[0, :2, 0] = [4.0, 20.0]  # one car lies across the window's left edge
    path = network(tmp_path / "fixed.onnx", {"output0": boxes}, NAMES, size=(128, 128))
    image = np.zeros((128, 192, 3), np.uint8)
    at = sorted(map(tuple, np.round(Detector(path)(image).centre).tolist()))
    assert at == [(4, 20), (90, 50), (64 + 90, 50)], "at the image's own edge it is left to the caller"
    assert len(Detector(path)(np.zeros((60, 70, 3), np.uint8))) == 2, "a small image is padded"


@pytest.mark.slow
@pytest.mark.parametrize(
    "outputs, metadata, message",
    [
        ({"output0": np.zeros((1, 84, 8400))}, {**NAMES, "task": "detect"}, "'detect', whose boxes have no direction"),
        ({"output0": raw()}, {**NAMES, "names": "{0: 'car'}"}, "contradicts itself"),
        ({"dets": np.zeros((1, 5, 5)), "labels": np.zeros((1, 5), int)}, {}, "any known detector of oriented boxes"),
        ({"output0": np.zeros((1, 1000))}, {}, r"outputs output0 \[1, 1000\] are not those of any known detector"),
        *(({"output0": raw()}, {**NAMES, "stride": s}, "its stride is") for s in ("0", "-32", "many", "9" * 5000)),
        ({"output0": raw()}, {**NAMES, "names": "[" * 5000 + "]" * 5000}, "names of its classes cannot be read"),
        ({"output0": raw()}, {**NAMES, "names": "{" + "-" * 90_000 + "1: 'car'}"}, "names of its classes cannot be"),
        ({"maps": np.zeros((1, 7, 8, 8))}, {"orthoscale": "[" * 90_000}, "orthoscale card"),
        (
            {"maps": np.zeros((1, 7, 8, 8))},
            {"orthoscale": '{"name": 5}'},
            r"card that can be read \(.* is missing|name",
        ),
        (
            {"boxes": np.zeros((5, 4)), "scores": np.zeros(5), "labels": np.zeros(5, int)},
            {},
            "not those of any known detector",
        ),
    ],
)
def test_other_networks_are_refused_in_words(tmp_path, outputs, metadata, message):
    path = network(tmp_path / "other.onnx", outputs, metadata)
    with pytest.raises(InputError, match=message):
        Detector(path)


@pytest.mark.parametrize("load", [Detector, lambda path: DepthNetwork(path, RULES["da3"])], ids=["boxes", "depth"])
def test_operators_of_others_and_their_library(tmp_path, monkeypatch, load):
    node = helper.make_node("NMSRotated", ["images"], ["dets"], domain="mmdeploy")
    graph = helper.make_graph(
        [node],
        "rotated",
        [helper.make_tensor_value_info("images", 1, [1, 3, 32, 32])],
        [helper.make_tensor_value_info("dets", 1, [1, 5, 6])],
    )
    opsets = [helper.make_opsetid("", 17), helper.make_opsetid("mmdeploy", 1)]
    onnx.save(helper.make_model(graph, opset_imports=opsets, ir_version=8), tmp_path / "rotated.onnx")
    with pytest.raises(InputError, match="set ORTHOSCALE_ONNX_OPS to the path of its libmmdeploy_onnxruntime_ops"):
        load(tmp_path / "rotated.onnx")
    monkeypatch.setenv("ORTHOSCALE_ONNX_OPS", str(tmp_path / "missing.so"))
    with pytest.raises(InputError, match="no library of operators"):
        load(tmp_path / "rotated.onnx")


@pytest.mark.parametrize(
    "size, batch", [((128, 128), 4), ((128, 128), 1)], ids=["batches of four", "one channel too many"]
)
def test_inputs_that_are_no_picture(tmp_path, size, batch):
    model = onnx.load(network(tmp_path / "a.onnx", {"output0": raw()}, NAMES, size=size))
    dims = model.graph.input[0].type.tensor_type.shape.dim
    dims[0].dim_value, dims[1].dim_value = batch, 3 if batch == 4 else 4
    onnx.save(model, tmp_path / "a.onnx")
    with pytest.raises(OrthoscaleError, match="its input has shape"):
        Detector(tmp_path / "a.onnx")


def test_the_whole_way_with_a_detector_of_others(tmp_path):
    """Twelve cars that a network of another family sees in a picture of 768 x 768 px, at every zoom."""
    cars = np.array([[60 + 110 * (k % 6), 80 + 300 * (k // 6), 40 + k % 3, 17, 0.1 * k, 0.9] for k in range(12)])
    weights = {
        "size": cars[None] * [1, 1, 1, 1, 0, 0] / 768,
        "rest": cars[None] * [0, 0, 0, 0, 1, 1],
    }
    nodes = [
        helper.make_node("Shape", ["images"], ["shape"], start=3, end=4),
        helper.make_node("Cast", ["shape"], ["width"], to=1),
        helper.make_node("Mul", ["size", "width"], ["sized"]),
        helper.make_node("Add", ["sized", "rest"], ["dets"]),
        helper.make_node("Identity", ["known_labels"], ["labels"]),
    ]
    graph = helper.make_graph(
        nodes,
        "twelve",
        [helper.make_tensor_value_info("images", 1, [1, 3, "h", "w"])],
        [helper.make_tensor_value_info("dets", 1, [1, 12, 6]), helper.make_tensor_value_info("labels", 7, [1, 12])],
        [numpy_helper.from_array(w.astype(np.float32), name) for name, w in weights.items()]
        + [numpy_helper.from_array(np.full((1, 12), 4), "known_labels")],
    )
    path = tmp_path / "a.onnx"
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), path)
    cv2.imwrite(str(tmp_path / "a.png"), np.random.default_rng(0).integers(80, 100, (768, 768, 3), np.uint8))
    result = orthoscale.estimate(tmp_path / "a.png", detector=path, zoom=1.0, fleet="DE")
    assert result.scale.vehicles_used == 12
    assert result.scale.interval90[0] < 4.37 / 41 < result.scale.interval90[1]
    assert result.scale.half_width < 0.2
    assert "mmrotate" in result.detections.detector
    hinted = orthoscale.estimate(tmp_path / "a.png", detector=path, gsd_hint=4.37 / 41, fleet="DE")
    assert hinted.detections.zoom == pytest.approx(38 / 41, rel=0.01)


# --- Objects of a standard size --------------------------------------------------------------------------------------

# Tennis courts: a whole one, one that ends 5 px from the left edge, one as large as the picture, a doubtful one.
COURTS = np.array(
    [
        [150.0, 120.0, 24.0 * 8, 11.0 * 8, 0.3, 0.9, 2],
        [49.0, 330.0, 11.0 * 8, 110.0, 0.0, 0.9, 2],
        [256.0, 256.0, 507.0, 236.0, 0.0, 0.9, 2],
        [300.0, 400.0, 24.0 * 8, 11.0 * 8, 0.0, 0.1, 2],
    ]
)


def with_courts(layout):
    rows = np.vstack([TRUTH, COURTS])
    names = {**NAMES, "names": "{0: 'large vehicle', 1: 'small vehicle', 2: 'Tennis Court'}"}
    if layout == "mmrotate":
        return {"dets": rows[None, :, :6], "labels": np.array([5, 4, 7])[rows[:, 6].astype(int)][None]}, {}
    if layout == "ultralytics-nms-free":
        return {"out": rows[None][:, :, [0, 1, 2, 3, 5, 6, 4]]}, {**names, "end2end": "True"}
    scores = np.full((len(rows), 3), 0.01)
    scores[np.arange(len(rows)), rows[:, 6].astype(int)] = rows[:, 5]
    return {"out": np.hstack([rows[:, :4], scores, rows[:, 4:5]]).T[None]}, names


@pytest.mark.parametrize("layout", ["ultralytics", "ultralytics-nms-free", "mmrotate"])
def test_standard_objects_are_seen_beside_vehicles(tmp_path, layout):
    outputs, names = with_courts(layout)
    detector = Detector(network(tmp_path / "a.onnx", outputs, names))
    image = np.zeros((512, 512, 3), np.uint8)
    seen = detector.see(image)
    assert seen["vehicle"].xylwa[np.argsort(-seen["vehicle"].score)] == pytest.approx(np.array(CARS), abs=1e-5)
    assert np.array_equal(detector(image).xylwa, seen["vehicle"].xylwa)
    assert set(seen) >= {"vehicle", "tennis-court"} and len(seen["tennis-court"]) == 3


def test_what_counts_as_vehicle_is_no_object(tmp_path):
    outputs, names = with_courts("ultralytics")
    called = Detector(network(tmp_path / "a.onnx", outputs, names), vehicle_classes=["tennis court"])
    assert not called.layout.objects
    outputs, _ = with_courts("mmrotate")
    numbered = Detector(network(tmp_path / "b.onnx", outputs), vehicle_classes=["7"])
    assert not numbered.layout.objects, "numbers of classes that are not DOTA's"


class Court:
    """A picture of nothing, but not of one colour."""

    name, width, height = "court.png", 512, 512

    def read(self, x, y, width, height, out_width, out_height):
        image = np.zeros((out_height, out_width, 3), np.uint8)
        image[::2] = 9
        return image


def test_objects_cut_by_an_edge_do_not_count(tmp_path):
    outputs, names = with_courts("ultralytics")
    detector = Detector(network(tmp_path / "a.onnx", outputs, names))
    looks = look_twice(Court(), Tile(0, 0, 512, 512, 512, 512), detector)
    fine, coarse = looks.objects["tennis-court"]
    assert fine.xylwa == pytest.approx(np.array([[150, 120, 192, 88, 0.3]]), abs=1e-4)
    assert len(coarse) == 1 and len(looks.fine) == 2
    cache = TileCache("key", tmp_path)
    with cache:
        tile = Tile(0, 0, 512, 512, 512, 512)
        cache.put(Court(), tile, looks)
        again = cache.get(Court(), tile)
    assert np.array_equal(again.objects["tennis-court"][0].xylwa, fine.xylwa)
    assert np.array_equal(again.fine.xylwa, looks.fine.xylwa)


def test_a_court_in_two_tiles_counts_once_and_becomes_evidence():
    court = Boxes([[900.0, 300.0, 237.7, 109.7, 0.2]], [0.9])
    none = Boxes.empty()
    jobs = [(Court(), Tile(x, 0, 1024, 1024, 1024, 1024)) for x in (0, 700)]
    cars = Boxes([[100.0 + 60 * k, 100, 44.0 + k % 3, 18.5, 0.1] for k in range(12)], np.full(12, 0.9))

    def visit(wanted):
        for number in wanted:
            yield number, Looks(cars, cars, {"tennis-court": (court, court), "container": (court, none)})

    found = sweep_twice(jobs, np.arange(2), visit)
    assert list(found.objects) == ["court.png"] and list(found.objects["court.png"]) == ["tennis-court"]
    (box,) = found.objects["court.png"]["tennis-court"].xylwa
    assert box == pytest.approx([900, 300, 237.7, 109.7, 0.2])
    ruler = Ruler(margin=(0, 0))
    detections = Detections(found.boxes, 1.0, ruler, (0.7, 0.5), "test", objects=found.objects)
    source = type(
        "Ortho",
        (),
        {
            "name": "court.png",
            "width": 2000,
            "height": 1000,
            "picture_names": ["court.png"],
            "unit": "m/px",
            "claimed": SimpleNamespace(aspect=1.0),
        },
    )()
    scale = measure(PlanGeometry.of(source, detections), load_fleet("DE"), Method(standards=standards())).scale
    (evidence,) = [e for e in scale.evidence if e.kind == "tennis court"]
    assert evidence.value == pytest.approx(0.1, rel=0.002)


def hostile(path, nodes, kind=onnx.TensorProto.FLOAT, image=onnx.TensorProto.FLOAT, weights=()):
    """An ONNX file that says that it is a YOLO of three classes, and whose output is made by `nodes`."""
    images = helper.make_tensor_value_info("images", image, [1, 3, "h", "w"])
    output = helper.make_tensor_value_info("output0", kind, [1, 8, "n"])
    graph = helper.make_graph(nodes, "hostile", [images], [output], weights)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, NAMES)
    onnx.save(model, path)
    return path


def known(name, array):
    return numpy_helper.from_array(np.array(array), name)


def endless(path):
    """Counts to 2^62."""
    kind, boolean = onnx.TensorProto.INT64, onnx.TensorProto.BOOL
    inside = [("count", kind), ("go", boolean), ("before", kind)], [("goes", boolean), ("after", kind)]
    values = [[helper.make_tensor_value_info(name, k, []) for name, k in some] for some in inside]
    steps = [helper.make_node("Identity", ["go"], ["goes"]), helper.make_node("Add", ["before", "one"], ["after"])]
    body = helper.make_graph(steps, "body", *values, [known("one", np.int64(1))])
    nodes = [
        helper.make_node("Loop", ["most", "yes", "zero"], ["counted"], body=body),
        helper.make_node("Cast", ["counted"], ["number"], to=onnx.TensorProto.FLOAT),
        helper.make_node("Expand", ["number", "shape"], ["output0"]),
    ]
    weights = [
        known("most", np.int64(2**62)),
        known("yes", True),
        known("zero", np.int64(0)),
        known("shape", [1, 8, 4]),
    ]
    return hostile(path, nodes, weights=weights)


def huge(path):
    """Six hundred million numbers."""
    nodes = [helper.make_node("ConstantOfShape", ["shape"], ["output0"])]
    return hostile(path, nodes, weights=[known("shape", [1, 8, 75_000_000])])


def long(path):
    """Less than the memory limit, but more than any detector has to say."""
    nodes = [helper.make_node("ConstantOfShape", ["shape"], ["output0"])]
    return hostile(path, nodes, weights=[known("shape", [1, 8, 3_000_000])])


def text(path):
    nodes = [helper.make_node("Cast", ["shape"], ["output0"], to=onnx.TensorProto.STRING)]
    return hostile(path, nodes, onnx.TensorProto.STRING, weights=[known("shape", np.ones((1, 8, 4)))])


def of_text(path):
    nodes = [helper.make_node("ConstantOfShape", ["shape"], ["output0"])]
    return hostile(path, nodes, image=onnx.TensorProto.STRING, weights=[known("shape", [1, 8, 4])])


def flat(path):
    """Says eight rows and has two of them."""
    nodes = [
        helper.make_node("Shape", ["images"], ["sizes"], start=2),
        helper.make_node("Div", ["sizes", "by"], ["fewer"]),
        helper.make_node("Concat", ["one", "fewer"], ["shape"], axis=0),
        helper.make_node("ConstantOfShape", ["shape"], ["output0"]),
    ]
    return hostile(path, nodes, weights=[known("by", [32, 1]), known("one", [1])])


@pytest.mark.slow
@pytest.mark.parametrize(
    "make, message",
    [
        (endless, "takes more than 3 s to process 64 x 64 px"),
        (huge, "within 1 GB of memory"),
        (long, r"fails on an image of 64 x 64 px \(its outputs hold 96000000 bytes\)"),
        (text, "an output holds no numbers"),
        (of_text, "its input is a tensor.string., not an image"),
        (flat, "are not those that its decoder 'ultralytics' reads"),
    ],
)
def test_a_hostile_network_ends_in_one_sentence(tmp_path, monkeypatch, capfd, make, message):
    monkeypatch.setattr(foreign, "LONGEST_SECONDS", 3.0)
    with pytest.raises(InputError, match=message):
        Detector(make(tmp_path / "a.onnx"))(np.zeros((64, 64, 3), np.uint8))
    assert capfd.readouterr() == ("", "")


@pytest.mark.slow
def test_a_network_that_ended_stays_so_and_leaves_no_process(tmp_path, monkeypatch):
    monkeypatch.setattr(foreign, "LONGEST_SECONDS", 3.0)
    detector = Detector(endless(tmp_path / "a.onnx"))
    process = detector._network._process
    for _ in range(2):
        with pytest.raises(InputError, match="takes more than 3 s"):
            detector(np.zeros((64, 64, 3), np.uint8))
    assert process.returncode is not None
    other = Detector(network(tmp_path / "b.onnx", {"output0": raw()}, NAMES))
    process = other._network._process
    assert process.poll() is None
    del other
    assert process.returncode is not None


def test_more_boxes_than_a_tile_can_hold_are_capped_with_a_word(tmp_path):
    boxes = np.tile(TRUTH[:1], (30_000, 1))
    boxes[:, 5] = np.linspace(0.6, 0.9, 30_000)
    dets = {"dets": boxes[None, :, :6], "labels": np.full((1, 30_000), 4)}
    detector, cars = found(network(tmp_path / "a.onnx", dets))
    assert len(cars) == MOST_BOXES and cars.score.min() > 0.79
    (note,) = detector.notes
    assert f"over {MOST_BOXES}" in note


def test_a_dask_worker_looks_with_the_network_of_its_sender(tmp_path):
    """Not with one that it loaded from the same path before, nor with another one that is there now."""
    path = network(tmp_path / "theirs.onnx", {"output0": raw()}, NAMES)
    first = Detector(path, threads=1)
    assert workers._detector(first.settings, first.sha256).sha256 == first.sha256
    network(path, {"output0": nms_free()}, {**NAMES, "end2end": "True"})
    second = Detector(path, threads=1)
    there = workers._detector(second.settings, second.sha256)
    assert there.layout.decoder == second.layout.decoder != first.layout.decoder
    workers._detector.cache_clear()
    with pytest.raises(InputError, match=r"theirs\.onnx: a Dask worker has another network"):
        workers._detector(first.settings, first.sha256)


def test_threads_share_somebodys_network(tmp_path):
    detector = Detector(network(tmp_path / "a.onnx", {"output0": raw()}, NAMES))
    with ThreadPoolExecutor(4) as pool:
        seen = list(pool.map(lambda size: detector(np.zeros((size, size, 3), np.uint8)), [64, 96, 128, 160] * 5))
    assert all(len(boxes) == 2 for boxes in seen)
