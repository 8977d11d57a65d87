// RUN: tai-opt %s --split-input-file --verify-diagnostics

// Two names of one place: the adjoint of one would not know of the other.
tai.tree @t : !tai.root<dense<[i: 4], {x: f64, g: f64}>>
// expected-note @+1 {{'@x' is this place}}
tai.field @x = @t["x"] : f64, rank 1, adjoint @g
tai.field @g = @t["g"] : f64, rank 1
// expected-error @+1 {{names place 'x' of @t, which is another field already; give it a place of its own}}
tai.field @y = @t["x"] : f64, rank 1

// -----

tai.tree @t : !tai.root<dense<[i: 4], {x: f64}>>
// expected-error @+1 {{is the adjoint of itself; its gradient would overwrite its values}}
tai.field @x = @t["x"] : f64, rank 1, adjoint @x

// -----

tai.tree @t : !tai.root<dense<[i: 4], {x: f64, y: f64, z: f64}>>
// expected-error @+1 {{is the adjoint of its adjoint, or of the adjoint of that}}
tai.field @x = @t["x"] : f64, rank 1, adjoint @y
tai.field @y = @t["y"] : f64, rank 1, adjoint @z
tai.field @z = @t["z"] : f64, rank 1, adjoint @x

// -----

tai.tree @t : !tai.root<dense<[i: 4], {x: f64, y: f64, g: f64}>>
// expected-note @+1 {{it is the adjoint of '@x'}}
tai.field @x = @t["x"] : f64, rank 1, adjoint @g
// expected-error @+1 {{has the adjoint '@g', which holds the derivatives of another field; give each field its own}}
tai.field @y = @t["y"] : f64, rank 1, adjoint @g
tai.field @g = @t["g"] : f64, rank 1

// -----

tai.tree @t : !tai.root<dense<[i: 4], {x: f64, g: f64}>>
// expected-error @+2 {{has '@g' for its adjoint and its dual; give it one field for each}}
// expected-note @+1 {{it is the adjoint of '@x'}}
tai.field @x = @t["x"] : f64, rank 1, adjoint @g, dual @g
tai.field @g = @t["g"] : f64, rank 1

// -----

// An adjoint has an adjoint of its own, and each of them a dual.
tai.tree @t : !tai.root<dense<[i: 4], {a: f64, b: f64, c: f64, d: f64, e: f64}>>
tai.tree @u : !tai.root<dense<[i: 4], {a: f64}>>
tai.field @x = @t["a"] : f64, rank 1, adjoint @g, dual @d
tai.field @g = @t["b"] : f64, rank 1, adjoint @gg, dual @e
tai.field @gg = @t["c"] : f64, rank 1
tai.field @d = @t["d"] : f64, rank 1
tai.field @e = @t["e"] : f64, rank 1
tai.field @other = @u["a"] : f64, rank 1

// -----

tai.kernel @inner() {
  tai.return
}
// expected-note @+1 {{kernel defined here}}
tai.kernel @outer() {
  // expected-error @+1 {{stands in a kernel; only the host can launch and record kernels. Move it into a 'func.func'}}
  tai.launch @inner() : () -> ()
  tai.return
}

// -----

tai.tree @t : !tai.root<{l: f64, lg: f64}>
tai.field @l = @t["l"] : f64, rank 0, adjoint @lg
tai.field @lg = @t["lg"] : f64, rank 0
// expected-note @+1 {{kernel defined here}}
tai.kernel @outer() {
  // expected-error @+1 {{'tai.tape' op stands in a kernel}}
  tai.tape loss(@l) {
  }
  tai.return
}

// -----

tai.tree @t : !tai.root<{l: f64, lg: f64}>
tai.field @l = @t["l"] : f64, rank 0, adjoint @lg
tai.field @lg = @t["lg"] : f64, rank 0
func.func @main(%c: i1) {
  // expected-note @+1 {{the outer tape begins here}}
  tai.tape loss(@l) {
    scf.if %c {
      // expected-error @+1 {{'tai.tape' op stands in another tape; one is recorded at a time. End the outer one first}}
      tai.tape loss(@l) {
      }
    }
  }
  return
}

// -----

tai.tree @t : !tai.root<{l: f64, lg: f64}>
tai.field @l = @t["l"] : f64, rank 0, adjoint @lg
tai.field @lg = @t["lg"] : f64, rank 0
func.func @main() {
  // expected-note @+1 {{the outer tape begins here}}
  tai_check.gradient loss(@l) wrt [@l] tolerance 1.0e-7 {
    // expected-error @+1 {{stands in another tape}}
    tai.tape loss(@l) {
    }
  }
  return
}

// -----

// expected-error @+1 {{has 'tai.gradients', but not 'tai.differentiate', so that no gradient would be made; add it, or remove 'tai.gradients'}}
func.func @f(%x: f64) -> f64 attributes {tai.gradients = array<i64: 0, 1>} {
  return %x : f64
}
