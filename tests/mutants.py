"""Changes of the program that a test must notice: `python -m tests.mutants` makes each in turn and runs that test;
`python -m tests.mutants drift.py` only those of files whose path has that in it.

Most were once made by hand and noticed by no fitting test. The program is put back as it was after each, also when the
run is stopped. `tests/test_mutants.py` keeps the table up to date with the program.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]


@dataclass(frozen=True)
class Mutant:
    """file : below orthoscale/. was, becomes : a text that stands in it once. test : what notices."""

    file: str
    was: str
    becomes: str
    test: str

    @property
    def path(self) -> Path:
        return ROOT / "orthoscale" / self.file


CHOICES, DRIFT, JUDGED = "tests/test_choices.py::", "tests/test_drift.py::", "tests/test_judgement.py::"
SUPPRESSED = f"{CHOICES}test_suppression_leaves_neighbours_and_takes_second_boxes_of_one_vehicle"
VERDICTS = f"{CHOICES}test_the_words_for_a_scale_follow_its_uncertainty"
BODY = f"{CHOICES}test_the_body_of_a_car_in_metres"
EVIDENCE, PROJECTED, PHOTO = "tests/test_evidence.py::", "tests/test_projection.py::", "tests/test_photo.py::"
ALIKE = f"{CHOICES}test_what_two_measurements_of_the_same_vehicles_may_differ_by"
LOWERED = f"{DRIFT}test_a_drift_is_a_part_of_the_uncertainty_and_lowers_the_verdict"
BLOCKS, FUSED, POOLING = "tests/test_blocks.py::", "tests/test_anchor_fusion.py::", "tests/test_pooling.py::"
EDITED = "tests/test_outputs_guard.py::test_a_file_that_was_edited_is_not_replaced"
UNITED = (
    "tests/test_systematic.py::test_vehicles_that_two_ways_measured_have_the_mean_that_errs_least_and_keep_their_noise"
)
CONSISTENT = "tests/test_consistency.py::"
GIVEN_BOXES = "tests/test_colmap.py::test_frames_are_compared_where_boxes_are_given"
FLIGHT = f"{CONSISTENT}test_other_programs_frames_of_another_flight"
MUTANTS = (
    Mutant("system/signatures.py", "kept = content[len(content) - len(text) + 1 :]", 'kept = b""', EDITED),
    Mutant("system/signatures.py", "all(crc != _crc(file, place)", "all(not crc", EDITED),
    Mutant("system/signatures.py", "block[: max(0, start - here)]", "block[:start]", EDITED),
    Mutant("core/boxes.py", "iou: float = 0.3)", "iou: float = 0.7)", SUPPRESSED),
    Mutant("core/boxes.py", "iou: float = 0.3)", "iou: float = 0.1)", SUPPRESSED),
    Mutant(
        "core/boxes.py",
        "SAME_VEHICLE = 0.5",
        "SAME_VEHICLE = 0.1",
        f"{CHOICES}test_two_passes_show_one_vehicle_only_where_their_boxes_overlap_by_half",
    ),
    Mutant(
        "detect/sweep.py",
        "np.sqrt(fine.sides[i] * coarse.sides[j])",
        "fine.sides[i]",
        f"{CHOICES}test_a_vehicles_box_is_the_geometric_mean_of_both_passes",
    ),
    Mutant(
        "core/pooling/agreement.py",
        "0.0 if one_network else",
        "0.0 if True else",
        f"{CHOICES}test_boxes_of_two_networks_differ_by_the_margins_of_both",
    ),
    Mutant(
        "core/pooling/agreement.py",
        "weight = (1 / own) / (1 / own).sum()",
        "weight = own / own.sum()",
        f"{CHOICES}test_of_two_measurements_the_more_certain_one_counts_more",
    ),
    Mutant(
        "core/projection/view.py",
        "LOWEST_ELEVATION = 25.0",
        "LOWEST_ELEVATION = 5.0",
        f"{CHOICES}test_a_photo_counts_vehicles_down_to_an_elevation_of_25_degrees",
    ),
    Mutant(
        "core/measuring/footing.py",
        "GROUND_SD = 0.01",
        "GROUND_SD = 0.0",
        f"{CHOICES}test_the_ground_of_a_model_is_known_to_a_hundredth_however_many_vehicles_stand_on_it",
    ),
    Mutant(
        "core/fleet.py",
        "self._country_covariance + self.log_covariance * place_scatter(self.place_vehicles)",
        "self._country_covariance + self.log_covariance * place_scatter(self.place_vehicles) / 25",
        f"{CHOICES}test_vehicles_of_one_place_stray_from_their_countrys_mean",
    ),
    Mutant("core/verdicts.py", '("good", 0.03)', '("good", 0.06)', VERDICTS),
    Mutant("core/verdicts.py", '("poor", 0.15)', '("poor", 0.30)', VERDICTS),
    Mutant(
        "core/verdicts.py", "SHAPE_LIMIT = 4.0", "SHAPE_LIMIT = 8.0", f"{JUDGED}test_lengths_and_widths_refuse_only"
    ),
    Mutant(
        "core/measuring/drift.py",
        "CHANCE = 0.01",
        "CHANCE = 0.4",
        f"{CHOICES}test_a_drift_is_reported_from_half_a_per_cent_of_chance_and_one_per_cent_of_the_scale",
    ),
    Mutant("core/measuring/drift.py", "EVEN_SD = 12**-0.5", "EVEN_SD = 0.1", LOWERED),
    Mutant("core/measuring/drift.py", "one_step_below(word) if lowered else word", "word", LOWERED),
    Mutant("core/measuring/drift.py", "severity=REFUSAL, hint=TO_MEND", "hint=TO_MEND", LOWERED),
    Mutant("core/projection/exact.py", "roof: float = 1.5", "roof: float = 1.8", BODY),
    Mutant("core/projection/exact.py", "corner: float = 0.25", "corner: float = 0.15", BODY),
    Mutant(
        "core/projection/exact.py",
        "BEND = 0.4",
        "BEND = 0.1",
        f"{CHOICES}test_walls_that_lean_do_so_from_the_bumpers_up",
    ),
    Mutant(
        "photos/tables.py",
        'write_layer(path, "photos", places, rows, "Point", WGS_84)',
        'write_layer(path, "photos", places, rows, "Point", "EPSG:3857")',
        "tests/test_photo.py::test_a_folder_becomes_a_table_in_every_format",
    ),
    Mutant(
        "core/measuring/vehicles.py",
        'table["length"], table["width"] = (size * scale.value).T',
        'table["length"], table["width"] = (1.01 * size * scale.value).T',
        "tests/test_vehicle_sizes.py",
    ),
    Mutant(
        "core/measuring/judgement.py",
        "r.severity in (REFUSAL, CAUTION)",
        "r.severity in (REFUSAL,)",
        f"{JUDGED}test_what_speaks_against_a_scale_comes_first",
    ),
    Mutant(
        "cli/crop.py",
        "place, radius, square, stride, size)",
        "place, radius, square, None, size)",
        "tests/test_every_option.py::test_what_would_do_nothing_is_refused",
    ),
    Mutant(
        "core/pooling/combining.py",
        "found.blurred(-(e.common**2)), e.own)",
        "found, e.own)",
        f"{EVIDENCE}test_an_error_that_vehicles_share_hides_no_contradiction_with_them",
    ),
    Mutant(
        "core/pooling/combining.py",
        "float(np.hypot(out.get(e.kind, 0.0), spread * w))",
        "float(spread * w)",
        f"{EVIDENCE}test_two_pieces_of_one_kind_are_one_part_of_the_uncertainty",
    ),
    Mutant(
        "core/pooling/combining.py",
        "for e in sorted(heard, key=lambda e: -e.common):",
        "for e in heard:",
        f"{EVIDENCE}test_in_which_order_evidence_comes_does_not_matter",
    ),
    Mutant(
        "core/pooling/combining.py",
        "if other.kind != e.kind and other.doubt <= STRONG:",
        "if other.doubt <= STRONG:",
        f"{EVIDENCE}test_evidence_does_not_support_a_scale_of_its_own_that_nothing_else_does",
    ),
    Mutant(
        "core/evidence.py",
        "np.exp(-0.5 * (off - off.min())) / np.sqrt(variance))",
        "np.exp(-0.5 * (off - off.min())))",
        f"{EVIDENCE}test_of_two_scales_about_as_near_the_sharper_one_is_meant",
    ),
    Mutant("core/pooling/agreement.py", "own += median_sd(each) ** 2", "own += 0", ALIKE),
    Mutant(
        "core/pooling/agreement.py",
        'b.parts.get("fleet", 0.0))) if alike else 0.0',
        'b.parts.get("fleet", 0.0)))',
        ALIKE,
    ),
    Mutant(
        "core/pooling/agreement.py",
        "max(agreement.apart**2 - agreement.apart_sd**2, 0.0)",
        "0.0",
        f"{CHOICES}test_a_difference_that_is_not_explained_is_the_mixs",
    ),
    Mutant(
        "core/pooling/agreement.py",
        "return next(contradicted, agreement.surer if agreement.contradicts else None)",
        "return agreement.surer if agreement.contradicts else next(contradicted, None)",
        f"{CHOICES}test_what_other_evidence_contradicts_stands_alone_though_the_other_is_surer",
    ),
    Mutant(
        "core/projection/exact.py",
        "(size > 0.05 * target / gain).all(1) & ",
        "",
        f"{PROJECTED}test_a_box_that_the_height_all_but_fills_shows_no_sliver_of_a_vehicle",
    ),
    Mutant(
        "core/projection/exact.py",
        "inset * max(self.front_inset, self.rear_inset)",
        "inset * min(self.front_inset, self.rear_inset)",
        f"{PROJECTED}test_with_the_least_lean_all_walls_just_stand_straight",
    ),
    Mutant(
        "core/projection/height.py",
        "np.stack([cosine, np.sqrt(1 - cosine**2)], -1)",
        "np.stack([np.sqrt(1 - cosine**2), cosine], -1)",
        f"{PROJECTED}test_a_height_shows_by_the_elevations_cotangent_on_the_side_that_points_to_the_camera",
    ),
    Mutant(
        "core/projection/view.py",
        "return self.ground[:, 2] / self.focal",
        "return np.linalg.norm(self.ground, axis=1) / self.focal",
        f"{PROJECTED}test_elevation_and_pixel_size",
    ),
    Mutant(
        "core/verdicts.py",
        "return worst(word, AT_BEST_DOUBTED) if doubted else word",
        "return word",
        f"{CHOICES}test_odd_shapes_lower_a_verdict_by_one_step_and_a_doubt_to_fair",
    ),
    Mutant(
        "core/pooling/agreement.py",
        '- {"geometry", "sampling", ',
        '- {"geometry", ',
        f"{CHOICES}test_the_same_vehicles_are_no_more_alike_for_being_as_many",
    ),
    Mutant(
        "core/pooling/agreement.py",
        "np.add(a.weights, b.weights) / 2",
        "np.add(a.weights, a.weights) / 2",
        f"{CHOICES}test_sizes_differ_as_both_scales_weigh_lengths_and_widths",
    ),
    Mutant(
        "core/pooling/posterior.py",
        "overlap = self._overlap(other) - 0.5 * np.log(2 * np.pi)",
        "overlap = self._overlap(other)",
        f"{EVIDENCE}test_a_doubtful_measurement_counts_as_bayes_has_it",
    ),
    Mutant(
        "core/pooling/combining.py",
        "counts |= (apart < SUPPORTS).any(1)",
        "counts |= (apart < CONFLICT_LIMIT).any(1)",
        f"{EVIDENCE}test_what_the_vehicles_exclude_counts_where_something_lies_within_two_sigmas_of_it",
    ),
    Mutant(
        "core/pooling/anchors.py",
        "np.minimum(alone, 1) @",
        "alone @",
        f"{FUSED}test_an_anchor_that_is_likely_a_mistake_is_no_vaguer_for_it",
    ),
    Mutant(
        "core/pooling/anchors.py",
        "precision = 1 / self.own",
        "precision = np.ones(len(self.own))",
        f"{FUSED}test_a_kind_of_sure_and_of_vague_anchors_errs_as_it_says",
    ),
    Mutant(
        "core/pooling/anchors.py",
        "if foreign else 1.0)",
        "if foreign else FOREIGN)",
        f"{FUSED}test_what_is_built_abroad_is_copied_seldom",
    ),
    Mutant(
        "core/pooling/anchors.py",
        "reading.rule + kind_sd**2",
        "reading.rule",
        f"{FUSED}test_what_only_a_kind_has_in_common_is_no_error_of_the_vehicles",
    ),
    Mutant(
        "core/pooling/mixture.py",
        "solved.unknown[solved.possible, SCALES] @ problem.weights",
        "solved.unknown[solved.possible, SCALES].mean(1)",
        f"{POOLING}test_where_widths_are_hardly_believed_lengths_tell_the_scale_whatever_widths_say",
    ),
    Mutant(
        "core/pooling/mixture.py",
        "np.sqrt(believed_share(p.shape[1])) * (np.eye",
        "1.0 * (np.eye",
        f"{POOLING}test_twice_as_many_vehicles_have_a_smaller_sampling_part_where_mixes_are_hardly_told_apart",
    ),
    Mutant(
        "core/pooling/usable.py",
        "np.diag(own) + ruler.common_sd**2",
        "np.diag(own)",
        f"{POOLING}test_what_lengths_and_widths_err_by_alike_is_left_in_their_mean",
    ),
    Mutant(
        "core/pooling/of_fleets.py",
        "mixes.append(Mix(classes, systematic, combine(systematic), fleet.place_vehicles))",
        "mixes.append(Mix(classes, systematic, combine(systematic + fleet.log_covariance / 8), fleet.place_vehicles))",
        f"{POOLING}test_lengths_and_widths_count_as_generalised_least_squares_has_it",
    ),
    Mutant(
        "core/pooling/of_fleets.py",
        "weights=weights - apart * (weights @ left) / before,",
        "weights=weights,",
        f"{POOLING}test_lengths_and_widths_count_as_generalised_least_squares_has_it",
    ),
    Mutant(
        "core/pooling/problem.py",
        "common = min(covariance[0, 1], *np.diag(covariance))",
        "common = covariance[0, 1]",
        f"{POOLING}test_wider_boxes_never_make_the_scale_larger",
    ),
    Mutant(
        "core/pooling/one_model.py",
        "WITHIN_MODEL * fleet.mean",
        "5 * WITHIN_MODEL * fleet.mean",
        "tests/test_one_model.py::test_a_lot_of_full_size_pickups_is_not_read_as_cars_at_another_scale",
    ),
    Mutant(
        "core/pooling/one_model.py",
        "fits.log_evidence - beforehand",
        "fits.log_evidence",
        "tests/test_one_model.py::test_the_evidence_is_that_of_a_mix_whose_only_class_is_the_model",
    ),
    Mutant(
        "core/normal.py",
        "return np.where(count <= len(OF_FEW), few, np.pi / 2 / (count + more))",
        "return 1 / count",
        "tests/test_constants.py::test_the_variance_of_a_median_is_that_of_the_order_statistics",
    ),
    Mutant(
        "core/pooling/mixture.py",
        "BAG = 2.0",
        "BAG = 1.0",
        f"{POOLING}test_how_few_vehicles_scatter_counts_one_and_a_half_times",
    ),
    Mutant(
        "core/pooling/by_kind.py",
        "(1 / strayed - 1)",
        "(1.5 / strayed - 1)",
        "tests/test_kinds.py::test_kinds_are_as_likely_in_a_country_as_simulated_places_have_them",
    ),
    Mutant(
        "core/measuring/squeeze.py",
        "moved = max(float(usual * (5 * usual - 4) @ off**2), spread / 2)",
        "moved = spread",
        "tests/test_squeeze.py::test_chance_is_as_large_as_it_says",
    ),
    Mutant(
        "core/measuring/parallax.py",
        "evidence = -0.5 * (log_determinant + lower",
        "evidence = -0.5 * (lower",
        "tests/test_parallax.py::test_the_ground_is_found_where_the_sheet_is_not",
    ),
    Mutant(
        "core/measuring/model_drift.py",
        "members[members != m]",
        "members",
        "tests/test_model_drift.py::test_a_frame_is_held_against_the_middle_of_the_others",
    ),
    Mutant(
        "core/measuring/anchors.py",
        "weight = 1 / variance / (1 / variance).sum()",
        "weight = variance / variance.sum()",
        "tests/test_anchors.py::test_of_the_frames_of_an_anchor_the_surer_ones_count_more",
    ),
    Mutant(
        "anchors/combs.py",
        "line - np.maximum(*sides)",
        "line - np.minimum(*sides)",
        "tests/test_anchors_followed.py::test_where_bright_ground_begins_there_is_no_line",
    ),
    Mutant(
        "core/measuring/joining.py",
        "np.diag(way.systematic.covariance) - shared",
        "np.diag(way.systematic.covariance)",
        UNITED,
    ),
    Mutant(
        "core/measuring/measure.py",
        "vote_noise(votes, seen.ruler) / vehicles.size",
        "vote_noise(votes, seen.ruler) / votes.size",
        "tests/test_plan.py::test_the_noise_of_votes_is_a_share_of_the_vehicles_sizes",
    ),
    Mutant(
        "core/measuring/surface.py",
        "noise = max(chi2 / freedom, 1.0) if",
        "noise = chi2 / freedom if",
        f"{DRIFT}test_cells_that_scatter_less_than_they_may_make_no_drift_surer",
    ),
    Mutant(
        "core/projection/exact.py",
        "good = settled & (size",
        "good = (size",
        f"{PROJECTED}test_a_size_that_more_steps_would_change_is_not_told",
    ),
    Mutant(
        "anchors/rails.py",
        "return median_sd(self.apart)",
        "return self.scatter",
        "tests/test_anchors_followed.py::test_the_middle_of_the_blocks_is_known_as_well_as_is_said",
    ),
    Mutant(
        "detect/tiles.py",
        "_spans(picture.height, zoom, tile, overlap)",
        "_spans(picture.height, zoom, tile, 0)",
        "tests/test_detect.py::test_tiles_cover_everything_and_overlap_enough",
    ),
    Mutant(
        "sources/lens.py",
        "size[1] / 2 + cy * share)",
        "size[1] / 2 + cy)",
        f"{PHOTO}test_dewarp_data_are_of_the_picture_that_the_camera_wrote_axis_by_axis",
    ),
    Mutant(
        "sources/lens.py",
        "sd = [NOMINAL_SD, ROUNDING_MM / tags.focal_35mm]",
        "sd = [NOMINAL_SD]",
        f"{PHOTO}test_how_well_a_focal_length_is_known_follows_from_where_it_is_from",
    ),
    Mutant(
        "system/outputs.py",
        "if inside(path, other.path) or inside(other.path, path):",
        "if False:",
        "tests/test_outputs_guard.py::test_outputs_of_one_command_never_share_a_place",
    ),
    Mutant(
        "photos/measure.py",
        "card_of(self.found).body_alone",
        "card_of(self.found)",
        f"{PHOTO}test_the_margin_is_left_in_the_sizes_from_which_it_is_taken_off_later",
    ),
    Mutant(
        "core/measuring/planar_sweep.py",
        "card_of(found).body_alone",
        "card_of(found)",
        f"{BLOCKS}test_how_far_up_boxes_of_ground_pictures_reach_is_not_known_exactly",
    ),
    Mutant(
        "core/votes.py",
        "missed >= FOUND_IN * self.shown",
        "self.views == 1",
        "tests/test_votes.py::test_what_is_missed_as_often_as_vehicles_are_found_is_a_mistake",
    ),
    Mutant(
        "core/measuring/model_drift.py",
        "np.average(each, axis=1, weights=weights)",
        "each.mean(1)",
        "tests/test_model_drift.py::test_an_axis_that_is_unsure_hardly_counts",
    ),
    Mutant(
        "core/measuring/model_drift.py",
        " * max(birge, 1.0)",
        "",
        "tests/test_model_drift.py::test_a_frame_whose_boxes_contradict_each_other_is_not_named",
    ),
    Mutant(
        "core/measuring/surroundings.py",
        "kept = ~votes.fleeting",
        "kept = np.ones(len(votes), bool)",
        "tests/test_model_evidence.py::test_vehicles_that_only_one_of_many_frames_shows_make_no_row",
    ),
    Mutant(
        "core/measuring/in_view.py",
        "count += inside & steep",
        "count += inside",
        "tests/test_model_evidence.py::test_a_frame_that_sees_a_place_from_too_low_does_not_count",
    ),
    Mutant(
        "core/measuring/planar_sweep.py",
        "above.offset / source.focal.ratio",
        "above.offset",
        f"{BLOCKS}test_where_the_focal_length_is_longer_than_in_the_model_cameras_stand_as_much_higher",
    ),
    Mutant(
        "core/measuring/oblique.py",
        ".with_focal(source.focal.ratio)",
        "",
        f"{BLOCKS}test_where_the_focal_length_is_longer_than_in_the_model_cameras_stand_as_much_higher",
    ),
    Mutant("core/measuring/joining.py", "np.maximum(views[ia], b.votes.views[ib])", "views[ia]", UNITED),
    Mutant("core/measuring/joining.py", "common_sd=float(", "common_sd=0 * float(", UNITED),
    Mutant(
        "core/measuring/vehicles.py",
        "log_scale[scale.used].mean() if",
        "log_scale.mean() if",
        "tests/test_vehicle_sizes.py::test_how_far_a_vehicle_is_off_is_told_from_the_mean_of_those_that_count",
    ),
    Mutant(
        "sources/json_model.py",
        "if _read_whole(_tracks_of(path)) else",
        "if True else",
        f"{CONSISTENT}test_an_image_that_a_sample_of_the_tracks_misses_is_not_left_out",
    ),
    Mutant("sources/json_model.py", "notes += check_frames(", "check_frames(", FLIGHT),
    Mutant("sources/text_model.py", "notes += check_frames(", "check_frames(", FLIGHT),
    Mutant("sources/colmap.py", "if compare_frames:", "if need_images:", GIVEN_BOXES),
    Mutant("actions/opening.py", "compare_frames=to_measure", "compare_frames=True", GIVEN_BOXES),
    Mutant(
        "photos/photo.py",
        "if doubt := beside_tags(lens, tags):",
        "if False:",
        f"{PHOTO}test_a_given_focal_length_that_is_another_cameras_is_told",
    ),
    Mutant(
        "layout/catalogue.py",
        'side * aisle["aisle"] / 2',
        'side * aisle["aisle"] / 3',
        "tests/test_layout.py::test_parking_has_as_many_bays_as_asked_for",
    ),
    Mutant(
        "layout/terminal.py",
        "if f.north_south and place.from_north > TOLERANCE:",
        "if not (f.north_south and place.from_north > TOLERANCE):",
        "tests/test_layout.py::test_the_summary_tells_which_courts_are_off_north_south",
    ),
    Mutant(
        "evaluate/surface.py",
        "stored[~np.isin(stored, NO_HEIGHT)]",
        "stored",
        "tests/test_evaluate.py::test_what_marks_no_height_is_known_as_it_is_stored",
    ),
    Mutant(
        "core/gps.py",
        "np.arange(len(heights) + 1)",
        "(0, len(heights))",
        "tests/test_gps.py::test_altitudes_across_the_level_of_the_sea_without_a_sign",
    ),
    Mutant(
        "sources/cloud_fit.py",
        "self.on >= OWN_SHARE * self.near",
        "self.dense",
        "tests/test_cloud_fit.py::test_a_thin_cloud_that_lies_on_the_points_is_the_models_own",
    ),
    Mutant(
        "sources/georeference.py",
        "x, y = width / 2, height / 2",
        "x, y = width / 3, height / 3",
        "tests/test_raster.py::test_a_claim_is_that_of_the_middle",
    ),
    Mutant(
        "sources/georeference.py",
        "abs(size / gsd - 1) > 0.002",
        "abs(size / gsd + 1) > 0.002",
        "tests/test_raster.py::test_a_unit_is_said_where_it_is_none_of_the_ground",
    ),
    Mutant(
        "sources/tags.py",
        "exif.get(0xA210)",
        "None",
        "tests/test_photo.py::test_the_unit_of_the_resolution_on_the_sensor",
    ),
    Mutant(
        "sources/tags.py",
        "in (5, 6, 7, 8)",
        "in (6, 7, 8)",
        "tests/test_photo.py::test_a_quarter_turn_that_exif_asks_for_is_said",
    ),
)


@contextmanager
def made(mutant: Mutant) -> Iterator[None]:
    """The program changed, and put back."""
    before = mutant.path.read_bytes()
    mutant.path.write_text(
        mutant.path.read_text(encoding="utf-8").replace(mutant.was, mutant.becomes), encoding="utf-8"
    )
    try:
        yield
    finally:
        mutant.path.write_bytes(before)


def exit_code(test: str) -> int:
    """Of pytest for that test: 0 if it passes, 1 if it fails, 5 if it is not there."""
    file, _, name = test.partition("::")
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-n", "0", "-p", "no:cacheprovider", file]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run([*command, *(["-k", name] if name else [])], cwd=ROOT, env=environment, capture_output=True)
    return done.returncode


def caught(mutant: Mutant) -> bool:
    """Whether its test fails; the test itself must be there."""
    with made(mutant):
        return exit_code(mutant.test) == 1


def main() -> None:
    """Prints each with whether it was noticed; exit code 1 if one was not, or if a test fails without any change."""
    survived = 0
    wanted = sys.argv[1:] or [""]
    chosen = [each for each in MUTANTS if any(word in each.file for word in wanted)]
    for test in dict.fromkeys(mutant.test for mutant in chosen):
        if exit_code(test):
            sys.exit(f"{test} fails as the program is, so it would seem to notice anything")
    for mutant in chosen:
        noticed = caught(mutant)
        survived += not noticed
        print(f"{'caught  ' if noticed else 'SURVIVED'}  {mutant.file}: {mutant.was} -> {mutant.becomes}", flush=True)
    sys.exit(min(survived, 1))


if __name__ == "__main__":
    main()
