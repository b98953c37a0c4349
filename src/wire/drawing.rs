//! Polygons as drawings: SVG, and DXF of release 12, which every CAD system reads.

use std::fmt::Write;

use serde::Serialize;
use utoipa::ToSchema;

use crate::boundary::section::{GRID_BITS, GridPoint};
use crate::boundary::slice::Slice;
use crate::wire::convert::float;

/// A polygon with holes. Rings are closed: the last point is the first again.
#[derive(Clone, PartialEq, Debug, Serialize, ToSchema)]
#[schema(as = SlicePolygon)]
pub(super) struct PolygonDocument {
    /// Its outline, counterclockwise.
    #[schema(value_type = Vec<Vec<f64>>, example = json!([[0, 0], [6, 0], [6, 6], [0, 6], [0, 0]]))]
    outer: Vec<[f64; 2]>,
    /// Its holes, clockwise.
    #[schema(value_type = Vec<Vec<Vec<f64>>>, example = json!([]))]
    holes: Vec<Vec<[f64; 2]>>,
}

impl PolygonDocument {
    /// The polygons of a slice in user units.
    pub(super) fn all(slice: &Slice, steps_per_unit: u32) -> Vec<Self> {
        let steps = f64::from(1_u32 << GRID_BITS) * f64::from(steps_per_unit);
        // The grid steps in a user unit are a whole number below 2^53: only the quotient is rounded, and coordinates beyond 2^53.
        let place = |grid: i64| float(grid.into()) / steps;
        let ring = |ring: &Vec<GridPoint>| {
            let points = ring.iter().chain(ring.first());
            points
                .map(|point| [place(point.x), place(point.y)])
                .collect()
        };
        let shapes = slice.shapes.iter().map(|shape| Self {
            outer: ring(&shape.outer),
            holes: shape.holes.iter().map(ring).collect(),
        });
        shapes.collect()
    }

    fn rings(&self) -> impl Iterator<Item = &Vec<[f64; 2]>> {
        std::iter::once(&self.outer).chain(&self.holes)
    }
}

/// Everything but the numbers is known to be plain.
const WRITES: &str = "writing to a string does not fail";

/// A box around polygons, which is empty without any: x, y, width and height.
fn around(polygons: &[PolygonDocument]) -> [f64; 4] {
    let points = polygons.iter().flat_map(|polygon| &polygon.outer);
    let start = [
        f64::INFINITY,
        f64::INFINITY,
        f64::NEG_INFINITY,
        f64::NEG_INFINITY,
    ];
    let [left, bottom, right, top] = points.fold(start, |around, &[x, y]| {
        [
            around[0].min(x),
            around[1].min(y),
            around[2].max(x),
            around[3].max(y),
        ]
    });
    if left > right {
        return [0.0, 0.0, 1.0, 1.0];
    }
    [left, bottom, right - left, top - bottom]
}

/// One path, filled by the even-odd rule, y up; the box that is seen is in user units.
pub(super) fn svg(polygons: &[PolygonDocument]) -> String {
    let [left, bottom, width, height] = around(polygons);
    let top = 0.0 - (bottom + height);
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"{left} {top} {width} {height}\">\
         <path fill=\"#888\" fill-rule=\"evenodd\" transform=\"scale(1 -1)\" d=\""
    );
    for ring in polygons.iter().flat_map(PolygonDocument::rings) {
        let corners = &ring[..ring.len() - 1];
        for (index, [x, y]) in corners.iter().enumerate() {
            let command = if index == 0 { 'M' } else { 'L' };
            write!(text, "{command}{x} {y}").expect(WRITES);
        }
        text.push('Z');
    }
    text.push_str("\"/></svg>\n");
    text
}

/// A closed polyline for each ring, outlines in the layer `outer`, holes in the layer `hole`.
pub(super) fn dxf(polygons: &[PolygonDocument]) -> String {
    let mut text =
        "0\nSECTION\n2\nHEADER\n9\n$ACADVER\n1\nAC1009\n0\nENDSEC\n0\nSECTION\n2\nENTITIES\n"
            .to_owned();
    for polygon in polygons {
        for (index, ring) in polygon.rings().enumerate() {
            let layer = if index == 0 { "outer" } else { "hole" };
            write!(
                text,
                "0\nPOLYLINE\n8\n{layer}\n66\n1\n10\n0.0\n20\n0.0\n30\n0.0\n70\n1\n"
            )
            .expect(WRITES);
            for [x, y] in &ring[..ring.len() - 1] {
                write!(
                    text,
                    "0\nVERTEX\n8\n{layer}\n10\n{x:?}\n20\n{y:?}\n30\n0.0\n"
                )
                .expect(WRITES);
            }
            write!(text, "0\nSEQEND\n8\n{layer}\n").expect(WRITES);
        }
    }
    text.push_str("0\nENDSEC\n0\nEOF\n");
    text
}
