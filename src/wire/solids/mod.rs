//! Scenes of solids in user units: shapes, solids and STL files in, mass properties out.
//!
//! ```text
//!   shapes ── cutters, boxes, hulls ──> Shape ─┐
//!   solids ── shape, from, to | at ────────────┴─> Body ──> engine ──> Totals ──> SolidProperties
//!          └─ hull | STL file ──────────────────────^
//! ```
//! Every fault has a place (a JSON pointer into what was read) and says what is wrong there. Floats end here: what goes on is on the
//! lattice, and a cutter's vertices are computed in integers.

mod body;
mod change;
mod documents;
mod polygon_error;
mod properties;
mod scale;
mod settings;
mod shape;
mod stl;
mod stock;

pub use self::body::{Shapes, body};
pub use self::change::SolidChange;
pub(in crate::wire) use self::change::{decoded, operation};
pub(in crate::wire) use self::documents::default_sides;
pub use self::documents::{
    BoxDocument, CornersDocument, CutterDocument, FitName, FormDocument, ShapeDocument,
    SolidDocument,
};
pub(in crate::wire) use self::polygon_error::PolygonError;
pub use self::properties::{
    ErrorBounds, ExactSolids, FixedPoint, SolidEdgeLength, SolidMeasures, SolidProperties,
    SolidSceneProperties, solid_area, solid_properties, solid_scene_properties, solid_volume,
};
pub use self::scale::{InvalidScale, Scale};
pub(in crate::wire) use self::settings::{
    DefinedShape, NewSolids, SolidSceneSettings, check, named_shape,
};
pub use self::settings::{SolidSettings, SolidSettingsDocument};
pub use self::shape::{ReadShape, shape};
pub use self::stl::{InvalidStl, stl_body};
pub use self::stock::{ReadStock, SolidStockDocument};

/// What is wrong with a document, and where.
#[derive(Clone, PartialEq, Eq, Debug, thiserror::Error)]
#[error("{} {what}", if pointer.is_empty() { "it" } else { pointer })]
pub struct SolidFault {
    /// Where: a JSON pointer, from the document's root.
    pub pointer: String,
    /// What is wrong there.
    pub what: String,
}

impl SolidFault {
    fn new(pointer: impl Into<String>, what: impl Into<String>) -> Self {
        Self {
            pointer: pointer.into(),
            what: what.into(),
        }
    }

    /// The same fault in a document that is a part of another, at this pointer in it.
    #[must_use]
    pub fn within(self, pointer: &str) -> Self {
        Self {
            pointer: format!("{pointer}{}", self.pointer),
            ..self
        }
    }
}
