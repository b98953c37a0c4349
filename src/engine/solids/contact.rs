//! Area of contact: how much new surface a move of a tool leaves, the faces along which it meets the material.
//!
//! ```text
//!    material |     |                 U   what is removed before
//!   __________|  P  |                 P   what the move sweeps, as far as it lies in the stock: the union of its convex parts
//!       U     :     |                 :   P's boundary in U: no contact
//!   __________:_____|                 |_  contact: in the boundary of U and P together, and not in that of U
//! ```
//! What lies in a plane of the stock is none: there the tool leaves the material and meets air.
//!
//! # Claim: a function of the set before and of the move alone
//! For an oriented plane `h` let `A(X)` be the area of the boundary of `X` in it. A part of the move that has a facet in `h` lies on its inner
//! side and covers nothing of it: `A` grows. A part that has none leaves nothing in it: `A` falls, to what is left of the surface before.
//! With `J` the parts without, and `K` those with a facet in `h`, the new surface in `h` is thus
//!
//! ```text
//!   A(U + J + K) - A(U + J) = sum over K:  A(U + J + K up to it) - A(U + J + K before it)
//! ```
//! Each of these terms is what a part adds to `A` of all others of its move but those of `K` after it: the marginal of the part, of
//! which only the flags in `h` are added up. The rounded values of the flags in one plane telescope as those of all do (`ledger.rs`). So no order of the parts
//! matters, nor where a path is cut into chords in a plane that they share. Of a move of one part it is what its own marginal has in its planes.

use std::collections::BTreeMap;
use std::ops::Range;

use crate::geometry::convex::Plane;

use super::batch::{Batch, Found};
use super::worker::Worker;
use super::{Engine, Measures};

/// What a move adds to the union of those before it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Added {
    /// All measures.
    pub measures: Measures,
    /// Twice its area of contact: of the union's surface after it that is neither surface before it nor in a plane of the stock. Units: `2^-16` steps
    /// squared. None of a move of more than 1,024 bodies.
    pub contact2: Option<i128>,
}

impl Engine {
    /// What the fresh part of a rank has of the contact of its move, whose ranks are given.
    pub(super) fn contact(
        &self,
        batch: &Batch,
        worker: &mut Worker,
        (rank, found): (usize, &Found),
        of_move: &Range<usize>,
    ) -> i128 {
        let later = || {
            let around = batch.fresh[rank].around.iter();
            let ranks = rank + 1..of_move.end;
            around.filter(move |other| {
                let other = batch.rank(other.slot);
                other.is_some_and(|other| ranks.contains(&other))
            })
        };
        // What adds nothing lies in those before it, and so does its boundary.
        if found.change.is_none() || later().next().is_none() {
            return found.books.contact2;
        }
        let mut planes: BTreeMap<Vec<u32>, Vec<Plane>> = BTreeMap::new();
        for face in &batch.fresh[rank].piece.faces {
            let shares = |slot: u32| {
                let mut around = later();
                let other = around.find(|other| other.slot == slot);
                other.is_some_and(|other| other.piece.faces.iter().any(|one| one.same(face)))
            };
            let sharing = later().map(|other| other.slot);
            let sharing = sharing.filter(|slot| shares(*slot)).collect();
            planes.entry(sharing).or_default().push(face.plane);
        }
        let contacts = planes.into_iter().map(|(left_out, planes)| {
            let counts = |slot: u32| match batch.rank(slot) {
                None => true,
                Some(other) => other != rank && other < of_move.end && !left_out.contains(&slot),
            };
            self.among(batch, rank, counts, |members| {
                worker.kernel.contact(members, planes)
            })
        });
        contacts.sum()
    }
}
