// RUN: tai-opt %s --split-input-file --verify-diagnostics --convert-tai-to-scf

tai.tree @t : !tai.root<dense<[i: 8], {x: f32}>>
tai.field @x = @t["x"] : f32, rank 1
tai.kernel @field_form() {
  // expected-error @+1 {{'tai.parallel_for' op runs over a field; expects a box, as tai-lower-struct-for makes it}}
  tai.parallel_for (%i) in @x {
  }
  tai.return
}

// -----

tai.tree @t : !tai.root<dense<[i: 8], {x: f32}>>
tai.field @x = @t["x"] : f32, rank 1
tai.kernel @atomic(%n: index, %x: f32) {
  %c0 = arith.constant 0 : index
  tai.parallel_for (%i) = (%c0) to (%n) {
    // expected-error @+1 {{'tai.atomic' op reaches the lowering of loops; expects tai-lower-layout to run before}}
    %0 = tai.atomic add %x, @x[%i] : f32
  }
  tai.return
}

// -----

tai.tree @t : !tai.root<dense<[i: 8], {x: f32}>>
tai.field @x = @t["x"] : f32, rank 1
tai.kernel @load(%i: index) -> f32 {
  // expected-error @+1 {{'tai.load' op still names a field; expects tai-lower-struct-for and tai-lower-layout to lower it first}}
  %0 = tai.load @x[%i] : f32
  tai.return %0 : f32
}

// -----

tai.kernel @captured_vector(%v: vector<2xf32>, %n: index) {
  %c0 = arith.constant 0 : index
  // expected-error @below {{'vector.extract' op uses 'vector<2xf32>'; expects scalars, as tai-scalarize makes them}}
  %0 = vector.extract %v[0] : f32 from vector<2xf32>
  tai.return
}

// -----

tai.kernel @local_vector() {
  // expected-error @+1 {{'tai.alloca' op holds 'vector<2xf32>'; expects a scalar, as tai-scalarize makes it}}
  %l = tai.alloca : !tai.local<vector<2xf32>>
  tai.return
}

// -----

func.func private @again(%x: f32) -> f32 attributes {passthrough = ["tai.lowered"]} {
  // expected-error @+1 {{'func.call' op calls 'again', which cannot be inlined; helpers cannot call themselves}}
  %0 = func.call @again(%x) : (f32) -> f32
  return %0 : f32
}

// -----

// expected-error @+1 {{'func.func' op expects one block: control flow of a host program stands in 'scf'}}
func.func @jumps() attributes {passthrough = ["tai.lowered"]} {
  cf.br ^bb1
^bb1:
  return
}

// -----

func.func @parallel_host(%n: index) {
  %c0 = arith.constant 0 : index
  // expected-error @+1 {{'tai.parallel_for' op cannot run on the host}}
  tai.parallel_for (%i) = (%c0) to (%n) {
  }
  return
}

// -----

tai.kernel @strange(%m: memref<?xf32>) {
  // expected-error @+1 {{'memref.cast' op cannot be lowered on an array argument of a kernel}}
  %0 = memref.cast %m : memref<?xf32> to memref<4xf32>
  tai.return
}

// -----

// expected-note @+1 {{defined here; control flow of a helper stands in 'scf'}}
func.func private @helper(%x: f32) -> f32 {
  cf.br ^next
^next:
  return %x : f32
}
func.func @host(%x: f32) attributes {passthrough = ["tai.lowered"]} {
  // expected-error @+1 {{calls 'helper', which cannot be inlined; helpers have one block}}
  %0 = func.call @helper(%x) : (f32) -> f32
  return
}

// -----

tai.kernel @bit() -> i1 {
  // expected-error @+1 {{attribute 'number' failed to satisfy constraint: 32-bit signless integer attribute whose value is non-negative whose maximum value is 63}}
  %0 = tai_rt.starts_at_zero 64
  tai.return %0 : i1
}
