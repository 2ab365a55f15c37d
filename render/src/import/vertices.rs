//! Which vertices of an accessor the triangles use. Files often let many primitives share one large vertex array.

/// Vertices of the file that a mesh keeps, ascending.
pub(super) enum Vertices {
    /// 0 .. count.
    All(usize),
    /// These.
    Some(Vec<u32>),
}

impl Vertices {
    /// Finds the vertices that `triangles` name among `count`, and renumbers the triangles to them.
    pub(super) fn used(triangles: &mut [[u32; 3]], count: usize) -> Self {
        let mut used: Vec<u32> = triangles.iter().flatten().copied().collect();
        if count <= used.len() {
            // Marking is linear; sorting is only for few triangles of a large array.
            let mut marked = vec![false; count];
            for vertex in used.drain(..) {
                if let Some(mark) = marked.get_mut(vertex as usize) {
                    *mark = true;
                }
            }
            used.extend(marked.iter().enumerate().filter(|(_, mark)| **mark).map(|(vertex, _)| vertex as u32));
        } else {
            used.sort_unstable();
            used.dedup();
        }
        if used.len() == count {
            return Vertices::All(count);
        }
        for vertex in triangles.iter_mut().flatten() {
            *vertex = used.binary_search(vertex).unwrap_or(0) as u32;
        }
        Vertices::Some(used)
    }
    /// How many.
    pub(super) fn len(&self) -> usize {
        match self {
            Vertices::All(count) => *count,
            Vertices::Some(list) => list.len(),
        }
    }
    /// Their numbers in the file, ascending.
    pub(super) fn iter(&self) -> impl ExactSizeIterator<Item = usize> + '_ {
        let list: &[u32] = match self {
            Vertices::All(_) => &[],
            Vertices::Some(list) => list,
        };
        let all = matches!(self, Vertices::All(_));
        (0..self.len()).map(move |i| if all { i } else { list.get(i).map_or(0, |v| *v as usize) })
    }
}
