//! What a listing hands out: exposed faces in floats.

use std::ops::ControlFlow;

use crate::geometry::CubeId;

/// Which boundary.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Region {
    /// Of the union of all bodies, whatever lies outside of a stock, too.
    Union,
    /// Of what the bodies remove from the stock.
    Removed,
    /// Of what remains of the stock. Normals point out of the material.
    Remaining,
}

/// What is exposed in one oriented plane: a set of polygons with holes, given by their edges.
///
/// Edges of one face form closed loops: at every vertex as many end as begin. Of all faces together every edge occurs as often in one
/// direction as in the other, and no vertex lies between the ends of an edge. A vertex is the point of floats nearest to the exact one, so
/// equal vertices are equal. No edge begins where it ends.
#[derive(Clone, PartialEq, Debug)]
pub struct Face {
    /// A body that has some of it, the least by id of those that are known to; none for the stock's own surface.
    pub body: Option<CubeId>,
    /// The outward normal, of length 1.
    pub normal: [f64; 3],
    /// Edges from the first to the second end, the face to their left as seen from outside. Units: steps.
    pub edges: Vec<[[f64; 3]; 2]>,
}

/// Takes faces one by one, and may end the listing.
pub type FaceSink<'a> = dyn FnMut(&Face) -> ControlFlow<()> + 'a;

/// A scene without a stock has nothing that is removed from it, and nothing that remains.
#[derive(Clone, Copy, PartialEq, Eq, Debug, thiserror::Error)]
#[error("the scene has no stock, so that nothing is removed and nothing remains")]
pub struct NoStock;
