//! Which edges and facets of a piece can still matter, and which other piece stands witness that the rest cannot.
//!
//! A *witness* of an edge or a facet is one other piece that dominates it whole: nothing of it is an edge, or bounds a crossing, that the
//! union would not get from the witness too. Features without a witness are *live*: only they are candidates of the kernel. Witnesses save
//! time and never change a result.

/// The witnesses of one piece's features, each by its place in a short list.
#[derive(Clone, Debug, Default)]
pub(super) struct Features {
    /// For each edge, then for each facet: 0, or one more than the place of its witness.
    marks: Box<[u8]>,
    edges: u16,
    /// The witnesses, by their slots; 0-length when there are none. A slot that is no longer used is free.
    witnesses: Vec<u32>,
}

/// A place of `witnesses` that is not used.
const FREE: u32 = u32::MAX;

impl Features {
    /// All live.
    pub(super) fn live(edges: usize, facets: usize) -> Self {
        Self {
            marks: vec![0; edges + facets].into_boxed_slice(),
            edges: u16::try_from(edges).expect("a solid has fewer than 2^16 edges"),
            witnesses: Vec::new(),
        }
    }

    fn marks_of_edges(&self) -> &[u8] {
        &self.marks[..usize::from(self.edges)]
    }

    fn marks_of_facets(&self) -> &[u8] {
        &self.marks[usize::from(self.edges)..]
    }

    /// The edges without a witness.
    pub(super) fn live_edges(&self) -> impl Iterator<Item = u16> + '_ {
        live(self.marks_of_edges())
    }

    /// The facets without a witness.
    pub(super) fn live_facets(&self) -> impl Iterator<Item = u16> + '_ {
        live(self.marks_of_facets())
    }

    pub(super) fn is_edge_live(&self, edge: usize) -> bool {
        self.marks_of_edges()[edge] == 0
    }

    pub(super) fn is_facet_live(&self, facet: u16) -> bool {
        self.marks_of_facets()[usize::from(facet)] == 0
    }

    /// The mark of a witness; none when the list is full, and then the feature stays live.
    pub(super) fn mark_of(&mut self, witness: u32) -> Option<u8> {
        let place = self.witnesses.iter().position(|one| *one == witness);
        let place = place.or_else(|| {
            let free = self.witnesses.iter().position(|one| *one == FREE);
            free.inspect(|place| self.witnesses[*place] = witness)
        });
        let place = place.unwrap_or_else(|| {
            self.witnesses.push(witness);
            self.witnesses.len() - 1
        });
        let mark = u8::try_from(place + 1).ok();
        if mark.is_none() {
            self.witnesses.pop();
        }
        mark
    }

    pub(super) fn set_edge(&mut self, edge: u16, mark: u8) {
        self.marks[usize::from(edge)] = mark;
    }

    pub(super) fn set_facet(&mut self, facet: u16, mark: u8) {
        self.marks[usize::from(self.edges) + usize::from(facet)] = mark;
    }

    /// The witnesses' slots.
    pub(super) fn witnesses(&self) -> impl Iterator<Item = u32> + '_ {
        let used = |witness: &u32| *witness != FREE;
        self.witnesses.iter().copied().filter(used)
    }

    /// The same with other slots of the witnesses.
    pub(super) fn renumbered(&self, number: impl Fn(u32) -> u32) -> Self {
        let renumber = |&witness: &u32| {
            if witness == FREE {
                FREE
            } else {
                number(witness)
            }
        };
        Self {
            marks: self.marks.clone(),
            edges: self.edges,
            witnesses: self.witnesses.iter().map(renumber).collect(),
        }
    }

    /// What is live when some witnesses are not there; none when nothing is that is not so anyway. Without a list of witnesses: to be read.
    pub(super) fn without_witnesses(&self, is_absent: impl Fn(u32) -> bool) -> Option<Self> {
        let mut absent = [false; u8::MAX as usize + 1];
        let mut is_any = false;
        for (place, &witness) in self.witnesses.iter().enumerate() {
            if witness != FREE && is_absent(witness) {
                absent[place + 1] = true;
                is_any = true;
            }
        }
        let mark = |mark: &u8| if absent[usize::from(*mark)] { 0 } else { *mark };
        is_any.then(|| Self {
            marks: self.marks.iter().map(mark).collect(),
            edges: self.edges,
            witnesses: Vec::new(),
        })
    }

    /// Makes live what a piece stood witness for, and adds these edges and facets to the lists.
    pub(super) fn lose(&mut self, witness: u32, edges: &mut Vec<u16>, facets: &mut Vec<u16>) {
        let Some(place) = self.witnesses.iter().position(|one| *one == witness) else {
            return;
        };
        self.witnesses[place] = FREE;
        let lost = u8::try_from(place + 1).expect("only places that have a mark are filled");
        let edge_count = self.edges;
        for (feature, mark) in (0_u16..).zip(self.marks.iter_mut()) {
            if *mark == lost {
                *mark = 0;
                if feature < edge_count {
                    edges.push(feature);
                } else {
                    facets.push(feature - edge_count);
                }
            }
        }
        while self.witnesses.last() == Some(&FREE) {
            self.witnesses.pop();
        }
    }

    /// Bytes that it takes beside itself.
    pub(super) fn size(&self) -> usize {
        self.marks.len() + self.witnesses.capacity() * size_of::<u32>()
    }
}

/// The places of the marks that are 0, eight marks at a time.
fn live(marks: &[u8]) -> Live<'_> {
    Live {
        marks,
        zeros: 0,
        next: 0,
    }
}

struct Live<'a> {
    /// Marks that were not looked at yet.
    marks: &'a [u8],
    /// The high bit of every byte that was 0 among the eight marks before `next`.
    zeros: u64,
    next: u16,
}

impl Iterator for Live<'_> {
    type Item = u16;

    #[inline]
    fn next(&mut self) -> Option<u16> {
        while self.zeros == 0 {
            let (eight, rest) = match self.marks.split_first_chunk::<8>() {
                Some((eight, rest)) => (*eight, rest),
                None if self.marks.is_empty() => return None,
                None => {
                    let mut eight = [u8::MAX; 8];
                    eight[..self.marks.len()].copy_from_slice(self.marks);
                    (eight, &[][..])
                }
            };
            self.marks = rest;
            self.zeros = zeros(u64::from_le_bytes(eight));
            self.next += 8;
        }
        let byte = self.zeros.trailing_zeros() / 8;
        self.zeros &= self.zeros - 1;
        let byte = u16::try_from(byte).expect("one of eight");
        Some(self.next - 8 + byte)
    }
}

/// The high bit of every byte that is 0.
fn zeros(bytes: u64) -> u64 {
    const LOW: u64 = 0x7f7f_7f7f_7f7f_7f7f;
    !(((bytes & LOW) + LOW) | bytes | LOW)
}
