//! What one thread needs to find witnesses and marginals.

use std::sync::Arc;

use super::face::Arithmetic;
use super::features::Features;
use super::lines::Member;
use super::marginal::{Kernel, Marginal};
use super::piece::Piece;
use super::witnesses::{Placed, Witnesses};

/// A kernel and its memory; apart from that of another thread in memory, too.
#[derive(Debug)]
#[repr(align(128))]
pub(super) struct Worker {
    pub(super) arithmetic: Arithmetic,
    pub(super) kernel: Kernel,
    witnesses: Witnesses,
    /// Features that are looked at.
    edges: Vec<u16>,
    facets: Vec<u16>,
}

impl Worker {
    pub(super) fn new(arithmetic: Arithmetic, stock: Option<Arc<Piece>>) -> Self {
        Self {
            arithmetic,
            kernel: Kernel::new(arithmetic, stock),
            witnesses: Witnesses::default(),
            edges: Vec::new(),
            facets: Vec::new(),
        }
    }

    /// Marks the live features of a piece that others dominate, the first ones first.
    pub(super) fn testify_all<'a>(
        &mut self,
        own: Placed,
        features: &mut Features,
        others: impl Iterator<Item = Placed<'a>>,
    ) {
        self.list_live(features);
        for other in others {
            if !self.testify_again(own, features, other) {
                break;
            }
        }
    }

    /// Marks the live features of a piece that another dominates.
    pub(super) fn testify(&mut self, own: Placed, features: &mut Features, other: Placed) {
        self.list_live(features);
        self.ask(own, features, other);
    }

    fn list_live(&mut self, features: &Features) {
        self.edges.clear();
        self.facets.clear();
        self.edges.extend(features.live_edges());
        self.facets.extend(features.live_facets());
    }

    /// Makes live what parts of these slots stood witness for; [`Self::testify_again`] is about these features. False when there are none.
    pub(super) fn lose(
        &mut self,
        features: &mut Features,
        slots: impl IntoIterator<Item = u32>,
    ) -> bool {
        self.edges.clear();
        self.facets.clear();
        for slot in slots {
            features.lose(slot, &mut self.edges, &mut self.facets);
        }
        !self.is_idle()
    }

    /// Marks those of the lost features that another piece dominates; false when none are left.
    pub(super) fn testify_again(
        &mut self,
        own: Placed,
        features: &mut Features,
        other: Placed,
    ) -> bool {
        if self.ask(own, features, other) {
            self.edges
                .retain(|edge| features.is_edge_live(usize::from(*edge)));
            self.facets.retain(|facet| features.is_facet_live(*facet));
        }
        !self.is_idle()
    }

    /// The lost features that are left.
    pub(super) fn take_lost(&mut self) -> (Vec<u16>, Vec<u16>) {
        let (edges, facets) = (&mut self.edges, &mut self.facets);
        (std::mem::take(edges), std::mem::take(facets))
    }

    /// Makes all these the lost features.
    pub(super) fn set_lost(&mut self, lost: Vec<(Vec<u16>, Vec<u16>)>) {
        self.edges.clear();
        self.facets.clear();
        for (edges, facets) in lost {
            self.edges.extend(edges);
            self.facets.extend(facets);
        }
    }

    /// What the first member adds to the union of the others, which are all that touch it.
    pub(super) fn marginal(&mut self, members: &[Member]) -> Marginal {
        self.kernel.marginal(members)
    }

    fn is_idle(&self) -> bool {
        self.edges.is_empty() && self.facets.is_empty()
    }

    /// Whether another piece dominates some of the features that are looked at; marks them.
    fn ask(&mut self, own: Placed, features: &mut Features, other: Placed) -> bool {
        let asked = (&self.edges[..], &self.facets[..]);
        !self.is_idle()
            && self
                .witnesses
                .testify(self.arithmetic, own, features, asked, other)
    }
}
