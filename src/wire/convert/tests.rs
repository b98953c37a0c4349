//! Units, settings and derived quantities against values from textbooks and an independent sum.

use ethnum::I256;

use super::derived::{float256, ratio};
use super::*;
use crate::engine::recount;
use crate::geometry::Place;

fn settings(edge: f64, steps_per_unit: u32) -> Settings {
    Settings::check(&SettingsDocument {
        steps_per_unit: f64::from(steps_per_unit),
        ..SettingsDocument::with_edge(edge)
    })
    .expect("these settings are good")
}

fn properties(settings: &Settings, corners: &[[i64; 3]]) -> MassProperties {
    let places = corners
        .iter()
        .map(|corner| Place::new(*corner, settings.edge()).unwrap());
    mass_properties(
        None,
        None,
        &recount(settings.edge(), None, places),
        settings,
    )
}

#[track_caller]
fn check_rounding(settings: &Settings, at: f64, corner: i32) {
    let place = settings.place([at, 0.0, 0.0]).unwrap();
    assert_eq!(place.corner()[0], corner, "{at}");
}

#[test]
fn halves_go_away_from_zero() {
    let settings = settings(6.0, 1000);
    for (at, corner) in [
        (0.0, 0),
        (0.0004, 0),
        (0.0005, 1),
        (-0.0005, -1),
        (0.0015, 2),
        (0.0025, 3),
        (-0.0025, -3),
        (0.000_499_999, 0),
        (1.0005, 1001),
        (0.0145, 15),
        (1.0245, 1025),
        (1_000_000.000_5, 1_000_000_001),
        (1_000_000.000_499, 1_000_000_000),
    ] {
        check_rounding(&settings, at, corner);
    }
    // Every half that a decimal of four places can say, near the origin and far away.
    for steps in (0..20_000).chain(1_000_000_000..1_000_001_000) {
        let decimal = format!("{}.{:03}5", steps / 1000, steps % 1000);
        check_rounding(&settings, decimal.parse().unwrap(), steps + 1);
        check_rounding(&settings, -decimal.parse::<f64>().unwrap(), -steps - 1);
    }
}

#[test]
fn of_a_centre_the_lower_corner_is_rounded() {
    let settings = Settings::check(&SettingsDocument {
        anchor: Anchor::Center,
        steps_per_unit: 1.0,
        ..SettingsDocument::with_edge(3.0)
    })
    .unwrap();
    for (at, corner) in [
        (1.5, 0),
        (0.0, -2),
        (2.0, 1),
        (1.4, 0),
        (-1.0, -3),
        (3.0, 2),
    ] {
        check_rounding(&settings, at, corner);
    }
}

#[test]
fn places_come_back_as_they_went() {
    let corners = [0, 1, -1, 7, 333_333, -999_999_999, 1_000_000_001, 1 << 29];
    for steps_per_unit in [1, 3, 7, 10, 1000, 25_400, STEPS_PER_UNIT_MAX] {
        for anchor in [Anchor::Corner, Anchor::Center] {
            for edge in [1, 2, 4001] {
                let settings = Settings::check(&SettingsDocument {
                    steps_per_unit: f64::from(steps_per_unit),
                    anchor,
                    rounding: Rounding::Reject,
                    ..SettingsDocument::with_edge(f64::from(edge) / f64::from(steps_per_unit))
                })
                .unwrap();
                assert_eq!(settings.edge().steps(), edge);
                for corner in corners {
                    let place = Place::new([corner; 3], settings.edge()).unwrap();
                    assert_eq!(
                        settings.place(settings.at(place)),
                        Ok(place),
                        "{settings:?}"
                    );
                }
            }
        }
    }
}

#[test]
fn off_the_lattice_is_refused_when_asked() {
    let settings = Settings::check(&SettingsDocument {
        rounding: Rounding::Reject,
        ..SettingsDocument::with_edge(6.0)
    })
    .unwrap();
    assert!(settings.place([0.1, 0.2, 0.3]).is_ok());
    assert!(settings.place([0.000_000_000_5, 0.0, 0.0]).is_ok());
    let refused = settings.place([0.0, 0.0, 0.000_1]).unwrap_err();
    assert_eq!(refused, (2, InvalidCoordinate::OffLattice { steps: 0.1 }));
    let refused = settings.place([0.0, f64::NAN, 0.0]).unwrap_err();
    assert_eq!(refused, (1, InvalidCoordinate::NotFinite));
    for far in [1_073_741.0, -1_073_741.825, 1e12, -1e300] {
        let (axis, fault) = settings.place([far, 0.0, 0.0]).unwrap_err();
        let fault = fault.to_string();
        assert_eq!(axis, 0);
        assert_eq!(
            fault,
            "puts a corner of the cube outside -1073741.824 to 1073741.824"
        );
    }
}

#[test]
fn settings_are_checked_field_by_field() {
    let faults = |wanted: SettingsDocument| match Settings::check(&wanted) {
        Ok(_) => vec![],
        Err(faults) => faults.iter().map(InvalidSetting::field).collect(),
    };
    let wanted = |edge, steps_per_unit| SettingsDocument {
        steps_per_unit,
        ..SettingsDocument::with_edge(edge)
    };
    assert_eq!(faults(wanted(3.175, 1000.0)), [""; 0]);
    assert_eq!(faults(wanted(0.1, 3.0)), ["edge"]);
    assert_eq!(faults(wanted(1.0 / 3.0, 3.0)), [""; 0]);
    assert_eq!(faults(wanted(0.0, 1000.0)), ["edge"]);
    assert_eq!(faults(wanted(-6.0, 1000.0)), ["edge"]);
    assert_eq!(faults(wanted(16_777.216, 1000.0)), [""; 0]);
    assert_eq!(faults(wanted(16_777.217, 1000.0)), ["edge"]);
    assert_eq!(faults(wanted(1e300, 1000.0)), ["edge"]);
    assert_eq!(faults(wanted(f64::INFINITY, 1000.0)), ["edge"]);
    assert_eq!(faults(wanted(1.0, 0.0)), ["steps_per_unit"]);
    assert_eq!(faults(wanted(1.0, 1.5)), ["steps_per_unit"]);
    assert_eq!(faults(wanted(1.0, 1e10)), ["steps_per_unit"]);
    let all = SettingsDocument {
        unit: String::new(),
        density: 0.0,
        ..wanted(f64::NAN, -1.0)
    };
    assert_eq!(faults(all), ["edge", "steps_per_unit", "unit", "density"]);
}

#[test]
fn settings_have_one_text() {
    let text = settings(3.175, 1000).text();
    let expected = r#"{"edge":3.175,"steps_per_unit":1000,"unit":"mm","density":1.0,"anchor":"corner","rounding":"nearest"}"#;
    assert_eq!(text, expected);
    assert_eq!(Settings::from_text(&text), Some(settings(3.175, 1000)));
    // What rounds to the same steps is the same edge.
    assert_eq!(settings(3.175_000_000_000_1, 1000).text(), text);
}

#[test]
fn one_cube_has_the_properties_of_the_textbook() {
    let shown = properties(&settings(6.0, 1000), &[[0, 0, 2500]]);
    assert_eq!(shown.user.volume, 216.0);
    assert_eq!(shown.user.area, 216.0);
    assert_eq!(shown.user.edge_length.total, 72.0);
    assert_eq!(shown.user.mass, 216.0);
    assert_eq!(
        shown.user.mean_curvature,
        std::f64::consts::FRAC_PI_4 * 72.0
    );
    assert_eq!(shown.user.centroid, Some([3.0, 3.0, 5.5]));
    assert_eq!(
        shown.user.inertia,
        [[1296.0, 0.0, 0.0], [0.0, 1296.0, 0.0], [0.0, 0.0, 1296.0]]
    );
    let bounds = shown.bounds.unwrap();
    assert_eq!((bounds.min, bounds.max), ([0.0, 0.0, 2.5], [6.0, 6.0, 8.5]));
    assert_eq!(shown.integers.vertices.corner, 8);
    assert_eq!(shown.integers.exact.volume, "216000000000");
    assert_eq!(
        shown.integers.exact.area_by_axis,
        ["72000000", "72000000", "72000000"]
    );
    assert_eq!(shown.integers.exact.edge_length.total, "72000");
    let text = serde_json::to_string(&shown).unwrap();
    assert!(!text.contains("-0.0"), "{text}");
}

#[test]
fn nothing_has_neither_centre_nor_bounds() {
    let shown = serde_json::to_value(properties(&settings(6.0, 1000), &[])).unwrap();
    assert_eq!(shown["centroid"], serde_json::Value::Null);
    assert_eq!(shown["bounds"], serde_json::Value::Null);
    assert_eq!(
        shown["inertia"],
        serde_json::json!([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    );
    assert_eq!(shown["volume"], 0.0);
    assert_eq!(
        shown["exact"]["second_moments3"],
        serde_json::json!(["0", "0", "0"])
    );
}

/// In floats the inertia of this far cube would be lost altogether: 10^18 steps squared against 10^0.
#[test]
fn inertia_does_not_depend_on_where_the_part_is() {
    let settings = settings(0.003, 1000);
    let part = [[0, 0, 0], [2, 1, 0], [1, 5, 9], [40, -7, 2]];
    let near = properties(&settings, &part);
    for far in [
        [1_000_000_000, 0, 0],
        [1_000_000_000, -1_000_000_000, 999_999_937],
        [-1_073_741_000, 1_073_741_000, -1_073_741_000],
    ] {
        let moved = part.map(|[x, y, z]| [x + far[0], y + far[1], z + far[2]]);
        let far = properties(&settings, &moved);
        for (far, near) in far
            .user
            .inertia
            .iter()
            .flatten()
            .zip(near.user.inertia.iter().flatten())
        {
            assert!((far / near - 1.0).abs() < 1e-12, "{far} {near}");
        }
    }
    let one = properties(&settings, &[[1_000_000_000; 3]]);
    let expected = 0.003f64.powi(5) / 6.0;
    for (axis, row) in one.user.inertia.iter().enumerate() {
        for (other, value) in row.iter().enumerate() {
            if axis == other {
                assert!((value / expected - 1.0).abs() < 1e-12, "{value}");
            } else {
                assert_eq!(*value, 0.0);
            }
        }
    }
}

/// Products of inertia against an independent sum over small cubes.
#[test]
fn products_of_inertia_have_their_places_and_signs() {
    let settings = settings(1.0, 1);
    // Two cubes apart: m = 1 each, at offsets +-(1, 2, 4.5) from the common centre.
    let shown = properties(&settings, &[[0, 0, 0], [2, 4, 9]]);
    let (x, y, z) = (1.0, 2.0, 4.5);
    let own = 2.0 / 6.0;
    let expected = [
        [own + 2.0 * (y * y + z * z), -2.0 * x * y, -2.0 * z * x],
        [-2.0 * x * y, own + 2.0 * (z * z + x * x), -2.0 * y * z],
        [-2.0 * z * x, -2.0 * y * z, own + 2.0 * (x * x + y * y)],
    ];
    for (value, expected) in shown
        .user
        .inertia
        .iter()
        .flatten()
        .zip(expected.iter().flatten())
    {
        assert!((value - expected).abs() < 1e-12, "{:?}", shown.user.inertia);
    }
}

#[test]
fn wide_integers_become_the_nearest_float() {
    let two = |power: u32| I256::new(1) << power;
    assert_eq!(float256(two(200)), 2f64.powi(200));
    assert_eq!(float256(-two(254)), -2f64.powi(254));
    // A tie goes to even; a single lost bit far below decides it the other way.
    let tie = two(200) + two(147);
    assert_eq!(float256(tie), 2f64.powi(200));
    assert_eq!(float256(tie + 1), 2f64.powi(200) + 2f64.powi(148));
    assert_eq!(float256(I256::new(i128::MIN)), -2f64.powi(127));
    assert_eq!(ratio(I256::new(-7), I256::new(2)), -3.5);
    assert_eq!(ratio(3 * two(200) + 1, two(201)), 1.5);
}
