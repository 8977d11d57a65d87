// RUN: tai-opt %s --tai-fuse-launches --split-input-file --verify-diagnostics

// Launches of kernels that are not there, or of other types, are left to the
// verifier, which speaks first.

func.func @main() {
  // expected-error@below {{names '@missing', which is not a kernel}}
  tai.launch @missing() : () -> ()
  tai.launch @missing() : () -> ()
  return
}

// -----

tai.tree @tree : !tai.root<dense<[i: 8], {x: f32}>>
tai.field @x = @tree["x"] : f32, rank 1
// expected-note@below {{kernel defined here}}
tai.kernel @f(%a: f32) {
  tai.parallel_for (%i) in @x {
    tai.store %a, @x[%i] : f32
  }
  tai.return
}
func.func @main(%t: i32) {
  // expected-error@below {{expects the type '(f32) -> ()' of the kernel}}
  tai.launch @f(%t) : (i32) -> ()
  tai.launch @f(%t) : (i32) -> ()
  return
}
