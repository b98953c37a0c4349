//! Prefetching memory that will be needed soon, so that the waits for several places overlap.

/// How many cubes ahead of the one at hand memory is prefetched.
pub(super) const AHEAD: usize = 8;

/// Prefetches the memory of an element; nothing happens when there is none of that index.
#[inline]
pub(super) fn prefetch<T>(elements: &[T], index: usize) {
    #[cfg(target_arch = "x86_64")]
    if let Some(element) = elements.get(index) {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        #[expect(unsafe_code, reason = "an instruction that every such processor has")]
        // SAFETY: SSE is part of x86-64, and a prefetch changes nothing, whatever the address.
        unsafe {
            _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(element).cast());
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (elements, index);
}
