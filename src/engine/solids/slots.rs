//! The convex parts of all bodies, by slot: lean records, and prepared pieces as far as a bounded memory goes.

use std::sync::Arc;

use super::Cursor;
use super::features::Features;
use super::piece::Piece;

/// Which part of which body a slot holds.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Part {
    pub(super) body: Cursor,
    pub(super) index: u32,
}

/// Where a part counts.
#[derive(Clone, Debug)]
pub(super) enum State {
    /// Among the parts whose union is the union.
    Exposed(Features),
    /// In the union of the exposed ones. The slot, where there is one, is of an exposed part that covers it alone.
    Covered(Option<u32>),
    /// Nowhere: it has no volume in common with the stock.
    Outside,
}

#[derive(Debug)]
struct Record {
    part: Part,
    state: State,
    /// Prepared, while memory lasts.
    piece: Option<Arc<Piece>>,
    /// Whether the piece was asked for since the last look for pieces to drop.
    is_recent: bool,
}

/// Records by slot.
#[derive(Debug)]
pub(super) struct Slots {
    records: Vec<Option<Record>>,
    free: Vec<u32>,
    /// Bytes of all prepared pieces, and the most that stay between changes.
    prepared: usize,
    prepared_max: usize,
    /// Where the next look for pieces to drop begins.
    hand: usize,
}

impl Slots {
    pub(super) fn new(prepared_max: usize) -> Self {
        Self {
            records: Vec::new(),
            free: Vec::new(),
            prepared: 0,
            prepared_max,
            hand: 0,
        }
    }

    /// A slot for a part that is prepared already, or is outside.
    pub(super) fn insert(&mut self, part: Part, piece: Option<Arc<Piece>>) -> u32 {
        self.prepared += piece.as_ref().map_or(0, |piece| piece.size());
        let record = Some(Record {
            part,
            state: State::Outside,
            piece,
            is_recent: true,
        });
        if let Some(slot) = self.free.pop() {
            self.records[slot as usize] = record;
            return slot;
        }
        self.records.push(record);
        u32::try_from(self.records.len() - 1).expect("fewer than 2^32 parts")
    }

    pub(super) fn remove(&mut self, slot: u32) {
        let record = self.records[slot as usize]
            .take()
            .expect("the slot is used");
        if let Some(piece) = record.piece {
            self.prepared -= piece.size();
        }
        self.free.push(slot);
    }

    fn record(&self, slot: u32) -> &Record {
        self.records[slot as usize]
            .as_ref()
            .expect("the slot is used")
    }

    fn record_mut(&mut self, slot: u32) -> &mut Record {
        self.records[slot as usize]
            .as_mut()
            .expect("the slot is used")
    }

    /// Its piece, if it is prepared now; that of one outside never is.
    pub(super) fn kept(&self, slot: u32) -> Option<&Arc<Piece>> {
        self.record(slot).piece.as_ref()
    }

    /// Which part it holds.
    pub(super) fn part(&self, slot: u32) -> Part {
        self.record(slot).part
    }

    pub(super) fn state(&self, slot: u32) -> &State {
        &self.record(slot).state
    }

    pub(super) fn set_state(&mut self, slot: u32, state: State) {
        self.record_mut(slot).state = state;
    }

    /// The features of an exposed part.
    pub(super) fn features(&self, slot: u32) -> &Features {
        match self.state(slot) {
            State::Exposed(features) => features,
            _ => unreachable!("only exposed parts are neighbours"),
        }
    }

    /// The same, to be changed.
    pub(super) fn features_mut(&mut self, slot: u32) -> &mut Features {
        match &mut self.record_mut(slot).state {
            State::Exposed(features) => features,
            _ => unreachable!("only exposed parts are neighbours"),
        }
    }

    /// The prepared piece of a slot, made by `prepare` where it was dropped.
    pub(super) fn piece(
        &mut self,
        slot: u32,
        prepare: impl FnOnce(Part) -> Arc<Piece>,
    ) -> Arc<Piece> {
        let record = self.record_mut(slot);
        record.is_recent = true;
        if let Some(piece) = &record.piece {
            return Arc::clone(piece);
        }
        let piece = prepare(record.part);
        record.piece = Some(Arc::clone(&piece));
        self.prepared += piece.size();
        piece
    }

    /// Drops pieces that were not asked for lately, until the rest fits.
    pub(super) fn tidy(&mut self) {
        while self.prepared > self.prepared_max {
            self.hand = if self.hand + 1 < self.records.len() {
                self.hand + 1
            } else {
                0
            };
            let Some(record) = &mut self.records[self.hand] else {
                continue;
            };
            if std::mem::take(&mut record.is_recent) {
                continue;
            }
            if let Some(piece) = record.piece.take() {
                self.prepared -= piece.size();
            }
        }
    }

    /// Bytes of the records, and of the prepared pieces.
    pub(super) fn size(&self) -> (usize, usize) {
        let of = |record: &Option<Record>| match record.as_ref().map(|record| &record.state) {
            Some(State::Exposed(features)) => features.size(),
            _ => 0,
        };
        let records = self.records.capacity() * size_of::<Option<Record>>();
        let features = self.records.iter().map(of).sum::<usize>();
        let free = self.free.capacity() * size_of::<u32>();
        (records + features + free, self.prepared)
    }
}
