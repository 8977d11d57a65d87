// RUN: tai-opt %s --split-input-file --verify-diagnostics --tai-check-lowerable
// RUN: tai-opt %s --split-input-file --verify-diagnostics --tai-to-llvm
// RUN: tai-opt %s --split-input-file --verify-diagnostics --tai-to-nvvm

// Nothing to say.
tai.kernel @fine(%a: f32) -> f32 {
  %0 = math.sin %a : f32
  tai.return %0 : f32
}

// -----

// A dialect that converts its ops itself.
tai.kernel @own(%a: index) -> i64 {
  %0 = index.mul %a, %a
  %1 = arith.index_cast %0 : index to i64
  tai.return %1 : i64
}

// -----

// The dialect converts others of its ops, and not this one.
tai.kernel @own_other(%a: f64) -> f64 {
  %0 = complex.create %a, %a : complex<f64>
  // expected-error @+2 {{'complex.sin' op is not lowered by this pipeline}}
  // expected-note @+1 {{run the passes that turn the dialect 'complex' into}}
  %1 = complex.sin %0 : complex<f64>
  %2 = complex.re %1 : complex<f64>
  tai.return %2 : f64
}

// -----

// An op that could be dropped as well is named at its place.
tai.kernel @foreign(%a: index) {
  // expected-error @+2 {{'shape.mul' op is not lowered by this pipeline}}
  // expected-note @+1 {{run the passes that turn the dialect 'shape' into those of arith, math, scf, memref, vector and func before}}
  %0 = shape.mul %a, %a : index, index -> index
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

// -----

tai.kernel @assertion(%c: i1) {
  // expected-error @+2 {{'cf.assert' op is not lowered in code of tai}}
  // expected-note @+1 {{write 'tai.assert'}}
  cf.assert %c, "message"
  tai.return
}

// -----

tai.kernel @thread() {
  // expected-error @+2 {{'gpu.thread_id' op is not lowered in code of tai}}
  // expected-note @+1 {{write 'tai.parallel_for'; the lowering chooses blocks and threads}}
  %0 = gpu.thread_id x
  tai.return
}

// -----

tai.kernel @print(%v: vector<4xf32>) {
  // expected-error @+2 {{'vector.print' op is not lowered in code of tai}}
  // expected-note @+1 {{write 'tai.print'}}
  vector.print %v : vector<4xf32>
  tai.return
}

// -----

// The op is named, and not the one in its region.
tai.kernel @fill(%m: memref<4xf32>, %v: f32) {
  // expected-error @+2 {{'linalg.fill' op is not lowered by this pipeline}}
  // expected-note @+1 {{'linalg'}}
  linalg.fill ins(%v : f32) outs(%m : memref<4xf32>)
  tai.return
}

// -----

tai.kernel @narrow(%v: f32) -> f32 {
  // expected-error @+2 {{'arith.truncf' op has a result of type 'f8E5M2', which is not lowered in code of tai}}
  // expected-note @+1 {{use f16, bf16, f32 or f64}}
  %0 = arith.truncf %v : f32 to f8E5M2
  %1 = arith.extf %0 : f8E5M2 to f32
  tai.return %1 : f32
}

// -----

memref.global "private" constant @numbers : memref<4xf32> = dense<1.0>
tai.kernel @global(%i: index) -> f32 {
  // expected-error @+2 {{'memref.get_global' op is not lowered in code of tai}}
  // expected-note @+1 {{pass the array as an argument, or put the numbers into a field}}
  %m = memref.get_global @numbers : memref<4xf32>
  %0 = memref.load %m[%i] : memref<4xf32>
  tai.return %0 : f32
}
