//! The memory that requests share: taken as bytes arrive, given back when they are answered, and shared fairly.
//!
//! # Fairness
//! A client may hold as much as is free. So one client alone comes to half of the budget, two to a third each, n to 1/(n+1) each; the
//! rest stays free for who comes next, however greedy those are that are there. Nobody waits for a client that holds its share, and
//! nobody's share is taken from it.
//!
//! After A. K. Choudhury and E. L. Hahne, Dynamic queue length thresholds for shared-memory packet switches, IEEE/ACM Transactions
//! on Networking 6 (1998), with their factor alpha = 1.

use std::collections::HashMap;
use std::net::{IpAddr, Ipv6Addr};
use std::pin::pin;
use std::sync::Arc;

use parking_lot::Mutex;
use tokio::sync::Notify;

/// Who takes.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum Client {
    /// Those at an address: of IPv6, at the 2^64 addresses that one customer has.
    At(IpAddr),
    /// Those who are not known by an address.
    Unknown,
    /// Audits, slices and what else reads a scene as a whole, whoever asks for it.
    Audits,
}

impl Client {
    /// The client at an address.
    pub fn at(address: IpAddr) -> Self {
        Self::At(match address.to_canonical() {
            IpAddr::V6(address) => {
                let network = address.to_bits() >> 64 << 64;
                IpAddr::V6(Ipv6Addr::from_bits(network))
            }
            v4 @ IpAddr::V4(_) => v4,
        })
    }
}

/// The memory that requests share. A clone is the same.
#[derive(Clone, Debug)]
pub struct Budget(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    bytes: u64,
    held: Mutex<Held>,
    /// Told when something is given back.
    freed: Notify,
}

/// What is held. A client that holds nothing is not in the table.
#[derive(Debug, Default)]
struct Held {
    all: u64,
    by: HashMap<Client, u64>,
}

/// What one request of a client holds; given back when it is dropped.
#[derive(Debug)]
pub struct Share {
    budget: Budget,
    client: Client,
    bytes: u64,
}

impl Budget {
    /// So many bytes.
    pub fn new(bytes: u64) -> Self {
        Self(Arc::new(Shared {
            bytes,
            held: Mutex::default(),
            freed: Notify::new(),
        }))
    }

    /// How many bytes there are.
    pub fn bytes(&self) -> u64 {
        self.0.bytes
    }

    /// How many are held.
    pub fn held(&self) -> u64 {
        self.0.held.lock().all
    }

    /// The most that one client comes to, when it is alone.
    pub fn share_max(&self) -> u64 {
        self.0.bytes / 2
    }

    /// A share of a client, of nothing yet.
    pub fn share(&self, client: Client) -> Share {
        Share {
            budget: self.clone(),
            client,
            bytes: 0,
        }
    }
}

impl Share {
    /// The budget that it is of.
    pub fn budget(&self) -> &Budget {
        &self.budget
    }

    /// Takes so many bytes more; false, and nothing taken, when the client would hold more than is free.
    pub fn take(&mut self, bytes: u64) -> bool {
        let Shared {
            bytes: all, held, ..
        } = &*self.budget.0;
        let mut held = held.lock();
        let free = all - held.all;
        let of_client = held.by.get(&self.client).copied().unwrap_or(0);
        // After it: what it holds then, and what is free then.
        let fits = of_client
            .checked_add(bytes)
            .is_some_and(|then| bytes <= free && then <= free - bytes);
        if fits && bytes > 0 {
            held.all += bytes;
            held.by.insert(self.client, of_client + bytes);
            self.bytes += bytes;
        }
        fits
    }

    /// Takes so many bytes more, as soon as the client may. For ever, when it never may.
    pub async fn take_when_free(&mut self, bytes: u64) {
        loop {
            let shared = Arc::clone(&self.budget.0);
            let mut freed = pin!(shared.freed.notified());
            // Before the try: what is given back right after it is not missed.
            freed.as_mut().enable();
            if self.take(bytes) {
                return;
            }
            freed.await;
        }
    }

    /// So many of its bytes, or all when it has less, as a share of their own.
    #[must_use = "what is parted is given back when it is dropped"]
    pub fn part(&mut self, bytes: u64) -> Self {
        let bytes = bytes.min(self.bytes);
        self.bytes -= bytes;
        Self {
            budget: self.budget.clone(),
            client: self.client,
            bytes,
        }
    }

    /// Takes over what another share of the same client has.
    pub fn join(&mut self, mut other: Self) {
        assert!(
            self.client == other.client,
            "shares of one client are joined"
        );
        self.bytes += std::mem::take(&mut other.bytes);
    }

    /// Gives back all but so many bytes.
    pub fn keep(&mut self, bytes: u64) {
        let Some(less) = self.bytes.checked_sub(bytes).filter(|less| *less > 0) else {
            return;
        };
        self.bytes = bytes;
        let shared = &self.budget.0;
        let mut held = shared.held.lock();
        held.all -= less;
        let of_client = held.by.get_mut(&self.client);
        let of_client = of_client.expect("a client that holds something is in the table");
        *of_client -= less;
        if *of_client == 0 {
            held.by.remove(&self.client);
        }
        drop(held);
        shared.freed.notify_waiters();
    }
}

impl Drop for Share {
    fn drop(&mut self) {
        self.keep(0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    fn client(number: u8) -> Client {
        Client::at([10, 0, 0, number].into())
    }

    /// Clients that take whatever they can come to equal parts, and there is one left for who comes next.
    #[test]
    fn greedy_clients_come_to_equal_parts_and_leave_one() {
        let budget = Budget::new(1000);
        for count in 1..=9 {
            let mut shares: Vec<_> = (0..count).map(|one| budget.share(client(one))).collect();
            let mut goes_on = true;
            while goes_on {
                goes_on = false;
                for share in &mut shares {
                    goes_on |= share.take(1);
                }
            }
            let part = 1000 / (u64::from(count) + 1);
            for share in &shares {
                assert!(share.bytes.abs_diff(part) <= 1, "{count}: {}", share.bytes);
            }
            // Two requests are one client's.
            assert!(!budget.share(client(0)).take(2));
            let mut next = budget.share(client(100));
            assert!(next.take(part / 2));
            drop((shares, next));
            assert_eq!(budget.held(), 0);
        }
    }

    /// Whatever is taken and given back: the books are those of the shares, and nobody takes more than is free.
    #[test]
    fn the_books_are_those_of_the_shares() {
        for seed in 1..50 {
            let mut random = Random::new(seed);
            let budget = Budget::new(200);
            let mut shares: Vec<Share> = Vec::new();
            for _ in 0..300 {
                let number = u8::try_from(random.below(3)).unwrap();
                match random.below(6) {
                    4 if !shares.is_empty() => {
                        let part = shares[0].part(random.below(20));
                        shares.push(part);
                    }
                    5 if shares.len() > 1 => {
                        let last = shares.pop().unwrap();
                        let of_one = |share: &&mut Share| share.client == last.client;
                        if let Some(other) = shares.iter_mut().find(of_one) {
                            other.join(last);
                        }
                    }
                    0 => shares.push(budget.share(client(number))),
                    1 if !shares.is_empty() => {
                        let index = usize::try_from(random.below(shares.len() as u64)).unwrap();
                        shares.swap_remove(index);
                    }
                    _ => {
                        let Some(share) = shares.last_mut() else {
                            continue;
                        };
                        let bytes = random.below(90);
                        if random.below(3) == 0 {
                            share.keep(bytes);
                        } else {
                            share.take(bytes);
                        }
                    }
                }
                let sum = |wanted: Option<Client>| -> u64 {
                    let is_wanted = |share: &&Share| wanted.is_none_or(|one| share.client == one);
                    shares
                        .iter()
                        .filter(is_wanted)
                        .map(|share| share.bytes)
                        .sum()
                };
                let held = budget.0.held.lock();
                assert_eq!(held.all, sum(None), "seed {seed}");
                assert!(held.all <= 200, "seed {seed}");
                for (client, bytes) in &held.by {
                    assert!(*bytes > 0 && *bytes == sum(Some(*client)), "seed {seed}");
                }
            }
        }
    }

    /// Who waits goes on when somebody gives back.
    #[tokio::test]
    async fn who_waits_goes_on_when_something_is_given_back() {
        let budget = Budget::new(100);
        let (mut first, mut second) = (budget.share(client(1)), budget.share(client(1)));
        assert!(first.take(50) && !second.take(1));
        let waits = tokio::spawn(async move {
            second.take_when_free(40).await;
            second.bytes
        });
        tokio::task::yield_now().await;
        assert!(!waits.is_finished());
        first.keep(5);
        assert_eq!(waits.await.unwrap(), 40);
    }

    #[test]
    fn the_addresses_of_one_customer_are_one_client() {
        let at = |text: &str| Client::at(text.parse().unwrap());
        assert_eq!(at("2001:db8::1"), at("2001:db8::ffff:1"));
        assert_ne!(at("2001:db8::1"), at("2001:db8:0:1::1"));
        assert_eq!(at("::ffff:10.0.0.1"), at("10.0.0.1"));
        assert_ne!(at("10.0.0.2"), at("10.0.0.1"));
    }
}
