// RUN: tai-opt %s --split-input-file --verify-diagnostics --tai-check-lowerable
// RUN: tai-opt %s --split-input-file --verify-diagnostics --tai-to-llvm
// RUN: tai-opt %s --split-input-file --verify-diagnostics --tai-to-nvvm

// Nothing to say.
tai.kernel @fine(%a: f32) -> f32 {
  %0 = math.sin %a : f32
  tai.return %0 : f32
}

// -----

// An op that could be dropped as well is named at its place.
tai.kernel @foreign(%a: index) {
  // expected-error @+2 {{'index.mul' op is not lowered by this pipeline}}
  // expected-note @+1 {{run the passes that turn the dialect 'index' into those of arith, math, scf, memref, vector and func before}}
  %0 = index.mul %a, %a
  tai.return
}

// -----

tai.tree @t : !tai.root<dense<[i: 8], {x: f32}>>
tai.field @x = @t["x"] : f32, rank 1

// In a loop, of which no pass knows the whole.
tai.kernel @nested() {
  %c0 = arith.constant 0.0 : f32
  tai.parallel_for (%i) in @x {
    // expected-error @+2 {{'affine.apply' op is not lowered by this pipeline}}
    // expected-note @+1 {{'affine'}}
    %0 = affine.apply affine_map<(d0) -> (d0 mod 8)>(%i)
    tai.store %c0, @x[%0] : f32
  }
  tai.return
}
