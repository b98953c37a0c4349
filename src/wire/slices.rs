//! Slices of scenes in user units: which plane, which bodies meet it, what comes of them.

use super::convert::{OFF_LATTICE_MAX, Settings};
use super::kind::ShownKind;
use super::solids::SolidSettings;
use crate::boundary::Region;
use crate::boundary::section::{Cut, GRID_BITS, Polygon};
use crate::boundary::slice::Slice;
use crate::engine::solids::{self, Body};
use crate::geometry::{Bounds, COORDINATE_MAX, Place, Stock};
use crate::service::{Cubes, Selected, Solids};

/// Bytes that a corner of a section takes until its slice is done: itself, its edge and the pieces that others cut it into, several times.
const CORNER_BYTES: u64 = 512;

/// A kind of scene whose bodies can be cut.
pub(super) trait SlicedKind: ShownKind {
    /// Lattice steps in a user unit.
    fn steps_per_unit(settings: &Self::Settings) -> u32;

    /// Label of the user unit.
    fn unit(settings: &Self::Settings) -> &str;

    /// The box around a body.
    fn bounds(body: &Self::Body, settings: &Self::Settings) -> Bounds;

    /// Bytes that a slice through a body takes for it.
    fn bytes(body: &Self::Body) -> u64;

    /// Where a plane cuts a body, each convex part by itself.
    fn cut(body: &Self::Body, settings: &Self::Settings, cut: Cut, to: &mut Vec<Polygon>);

    /// Where a plane cuts the stock.
    fn cut_stock(stock: &Self::Stock, cut: Cut) -> Option<Polygon>;
}

impl SlicedKind for Cubes {
    fn steps_per_unit(settings: &Settings) -> u32 {
        settings.steps_per_unit()
    }

    fn unit(settings: &Settings) -> &str {
        settings.unit()
    }

    fn bounds(place: &Place, settings: &Settings) -> Bounds {
        Bounds {
            min: place.corner(),
            max: place.corner().map(|low| low + settings.edge().steps()),
        }
    }

    fn bytes(_: &Place) -> u64 {
        4 * CORNER_BYTES
    }

    fn cut(place: &Place, settings: &Settings, cut: Cut, to: &mut Vec<Polygon>) {
        to.extend(cut.of_box(&Self::bounds(place, settings)));
    }

    fn cut_stock(stock: &Stock, cut: Cut) -> Option<Polygon> {
        cut.of_box(&stock.bounds())
    }
}

impl SlicedKind for Solids {
    fn steps_per_unit(settings: &SolidSettings) -> u32 {
        settings.scale().steps_per_unit()
    }

    fn unit(settings: &SolidSettings) -> &str {
        settings.unit()
    }

    fn bounds(body: &Body, _: &SolidSettings) -> Bounds {
        body.bounds()
    }

    fn bytes(body: &Body) -> u64 {
        let corners = match (body.sweep(), body.hull()) {
            (Some((shape, ..)), _) => shape.parts().iter().map(|part| part.edges().len()).sum(),
            (None, Some(hull)) => hull.edges().len(),
            (None, None) => 0,
        };
        corners as u64 * CORNER_BYTES
    }

    fn cut(body: &Body, _: &SolidSettings, cut: Cut, to: &mut Vec<Polygon>) {
        let parts = (0..body.len()).map(|part| body.part(part));
        to.extend(parts.filter_map(|part| cut.of_solid(&part)));
    }

    fn cut_stock(stock: &solids::Stock, cut: Cut) -> Option<Polygon> {
        cut.of_solid(stock.solid())
    }
}

/// Where a plane is that is at a coordinate in user units: at a lattice point when it is within a millionth of a step of one, else at the
/// nearest point of the grid. Beyond all bodies it is drawn in to where there are none.
#[expect(
    clippy::cast_possible_truncation,
    reason = "a whole number that is below 2^61"
)]
pub(super) fn level(at: f64, steps_per_unit: u32) -> i64 {
    let far = f64::from(COORDINATE_MAX) + 1.0;
    let steps = (at * f64::from(steps_per_unit)).clamp(-far, far);
    let whole = steps.round();
    let steps = if (steps - whole).abs() <= OFF_LATTICE_MAX {
        whole
    } else {
        steps
    };
    (steps * f64::from(1_u32 << GRID_BITS)).round() as i64
}

/// The bodies of a scene that planes meet, to be cut by one plane after the other, upwards.
pub(super) struct Stack<K: SlicedKind> {
    settings: std::sync::Arc<K::Settings>,
    selected: Selected<K>,
    axis: usize,
    /// Boxes and places of the bodies by where they begin along the axis, the greatest first.
    waiting: Vec<(Bounds, usize)>,
    /// Those that the last plane has come to.
    reached: Vec<(Bounds, usize)>,
}

impl<K: SlicedKind> Stack<K> {
    pub(super) fn new(
        settings: std::sync::Arc<K::Settings>,
        selected: Selected<K>,
        axis: usize,
    ) -> Self {
        let bodies = selected.bodies.iter().enumerate();
        let mut waiting: Vec<_> = bodies
            .map(|(index, body)| (K::bounds(body, &settings), index))
            .collect();
        waiting.sort_by_key(|(bounds, index)| std::cmp::Reverse((bounds.min[axis], *index)));
        Self {
            settings,
            selected,
            axis,
            waiting,
            reached: Vec::new(),
        }
    }

    /// The slice at a place that is not below those before; none when `goes_on`, which is asked now and then, says no.
    pub(super) fn slice(
        &mut self,
        at: i64,
        region: Region,
        goes_on: &dyn Fn() -> bool,
    ) -> Option<Slice> {
        let cut = Cut {
            axis: self.axis,
            at,
        };
        let begins = |bounds: &Bounds| i64::from(bounds.min[self.axis]) << GRID_BITS;
        while let Some(next) = self.waiting.pop_if(|(bounds, _)| begins(bounds) <= at) {
            self.reached.push(next);
        }
        self.reached.retain(|(bounds, _)| cut.meets(bounds));
        let mut sections = Vec::with_capacity(self.reached.len());
        for (place, (_, index)) in self.reached.iter().enumerate() {
            if place % 1024 == 0 && !goes_on() {
                return None;
            }
            let body = &self.selected.bodies[*index];
            K::cut(body, &self.settings, cut, &mut sections);
        }
        let stock = self.selected.stock.as_ref();
        let stock = stock.and_then(|stock| K::cut_stock(stock, cut));
        goes_on().then(|| Slice::of(&sections, stock.as_ref(), region))
    }
}
