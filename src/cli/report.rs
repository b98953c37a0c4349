//! Mass properties for people.

use std::fmt::Write;

use serde_json::Value;

/// The API's `mass_properties` object as a table, of cubes or of solids. `unit` is the label of the user unit.
pub(crate) fn table(properties: &Value, unit: &str) -> String {
    let number = |path: &str| figure(&properties[path]);
    let edges = &properties["edge_length"];
    let vertices = &properties["vertices"];
    let error = &properties["error_max"];
    let mut text = String::new();
    let mut row = |name: &str, value: String| {
        writeln!(text, "{name:<22}{value}").expect("a string takes everything");
    };
    for count in ["cubes", "solids"] {
        if !properties[count].is_null() {
            row(count, number(count));
        }
    }
    row("volume", format!("{} {unit}^3", number("volume")));
    row("area", format!("{} {unit}^2", number("area")));
    row(
        "edge length",
        format!(
            "{} {unit} (convex {}, concave {}, crossing {})",
            figure(&edges["total"]),
            figure(&edges["convex"]),
            figure(&edges["concave"]),
            figure(&edges["crossing"]),
        ),
    );
    row("mass", number("mass"));
    if !properties["mean_curvature"].is_null() {
        row(
            "mean curvature",
            format!("{} {unit}", number("mean_curvature")),
        );
    }
    row(
        "centroid",
        format!("{} {unit}", triple(&properties["centroid"])),
    );
    for (axis, name) in ["inertia x", "inertia y", "inertia z"]
        .into_iter()
        .enumerate()
    {
        row(name, triple(&properties["inertia"][axis]));
    }
    let bounds = &properties["bounds"];
    row(
        "bounds",
        format!(
            "{} to {} {unit}",
            triple(&bounds["min"]),
            triple(&bounds["max"])
        ),
    );
    if !vertices.is_null() {
        row("Euler characteristic", number("euler_characteristic"));
        row(
            "vertices",
            format!(
                "{} (corner {}, edge-face {}, three-face {}, degenerate {})",
                figure(&vertices["total"]),
                figure(&vertices["corner"]),
                figure(&vertices["edge_face"]),
                figure(&vertices["three_face"]),
                figure(&vertices["degenerate"]),
            ),
        );
    }
    if !error.is_null() {
        row(
            "rounded by at most",
            format!(
                "volume {} {unit}^3, area {} {unit}^2, edge length {} {unit}, centroid {} {unit}, inertia {}",
                figure(&error["volume"]),
                figure(&error["area"]),
                figure(&error["edge_length"]),
                figure(&error["centroid"]),
                figure(&error["inertia"]),
            ),
        );
    }
    text
}

/// What of a stock is removed and what remains, in the same form; nothing where there is none.
pub(crate) fn parts(properties: &Value, unit: &str) -> String {
    let mut text = String::new();
    for part in ["removed", "remaining"] {
        let measures = &properties[part];
        if !measures.is_null() {
            let [volume, area] = ["volume", "area"].map(|name| figure(&measures[name]));
            let edges = figure(&measures["edge_length"]["total"]);
            writeln!(
                text,
                "{part:<22}{volume} {unit}^3, area {area} {unit}^2, edge length {edges} {unit}"
            )
            .expect("a string takes everything");
        }
    }
    text
}

/// Three numbers, or a dash where there are none.
fn triple(value: &Value) -> String {
    match value.as_array() {
        Some(values) => values.iter().map(figure).collect::<Vec<_>>().join(", "),
        None => "-".to_owned(),
    }
}

/// A number for the eye: thousands apart, at most six digits after the point.
pub(crate) fn figure(value: &Value) -> String {
    let Some(float) = value.as_f64() else {
        return "-".to_owned();
    };
    if float != 0.0 && !(1e-3..1e15).contains(&float.abs()) && !value.is_i64() && !value.is_u64() {
        return format!("{float:.6e}");
    }
    let text = match value {
        Value::Number(whole) if whole.is_i64() || whole.is_u64() => whole.to_string(),
        _ => {
            let text = format!("{float:.6}");
            text.trim_end_matches('0').trim_end_matches('.').to_owned()
        }
    };
    grouped(&text)
}

/// A number with exactly three digits after the point, for columns.
pub(crate) fn column(value: &Value) -> String {
    value
        .as_f64()
        .map_or_else(|| "-".to_owned(), |float| grouped(&format!("{float:.3}")))
}

/// A decimal number with its thousands apart.
pub(crate) fn grouped(text: &str) -> String {
    let (sign, text) = text
        .strip_prefix('-')
        .map_or(("", text), |rest| ("-", rest));
    let (whole, fraction) = text
        .split_once('.')
        .map_or((text, None), |(whole, part)| (whole, Some(part)));
    let mut grouped = String::from(sign);
    for (index, digit) in whole.chars().enumerate() {
        if index > 0 && (whole.len() - index).is_multiple_of(3) {
            grouped.push(',');
        }
        grouped.push(digit);
    }
    if let Some(fraction) = fraction {
        grouped.push('.');
        grouped.push_str(fraction);
    }
    grouped
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_for_the_eye() {
        for (value, text) in [
            ("0", "0"),
            ("1234567", "1,234,567"),
            ("-1234.5", "-1,234.5"),
            ("123.0", "123"),
            ("0.125", "0.125"),
            ("1234.5678912", "1,234.567891"),
            ("1e-9", "1.000000e-9"),
            ("2.5e20", "2.500000e20"),
            ("null", "-"),
        ] {
            let value = serde_json::from_str(value).expect("JSON");
            assert_eq!(figure(&value), text);
        }
        assert_eq!(column(&1_234.5.into()), "1,234.500");
    }
}
