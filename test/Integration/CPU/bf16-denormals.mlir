// RUN: tai-run %s --no-cache | FileCheck %s
// RUN: tai-run %s --no-cache --opt-level=0 | FileCheck %s
// RUN: tai-run %s --interpret | FileCheck %s
// RUN: tai-run %s --no-cache --print-ir=asm 2>&1 | FileCheck %s --check-prefix=ASM

// ASM-NOT: {{cvtneps2bf16|truncsfbf2}}

// Rounding to bf16 keeps denormals, also where the processor has an instruction
// that does not, in vectorised loops and beside them.
tai.tree @t : !tai.root<dense<[i: 64], {f: f32, h: bf16, sum: bf16}>>
tai.field @f = @t["f"] : f32, rank 1
tai.field @h = @t["h"] : bf16, rank 1
tai.field @sum = @t["sum"] : bf16, rank 1

tai.kernel @set(%i: index, %bits: i32) {
  %v = arith.bitcast %bits : i32 to f32
  tai.store %v, @f[%i] : f32
  tai.return
}

tai.kernel @round() {
  tai.parallel_for (%i) in @f {
    %v = tai.load @f[%i] : f32
    %r = arith.truncf %v : f32 to bf16
    tai.store %r, @h[%i] : bf16
  }
  tai.return
}

// Arithmetic rounds as well.
tai.kernel @halve() {
  tai.parallel_for (%i) in @h {
    %half = arith.constant 0.5 : bf16
    %v = tai.load @h[%i] : bf16
    %r = arith.mulf %v, %half : bf16
    tai.store %r, @sum[%i] : bf16
  }
  tai.return
}

// So do extrema and functions that return whole numbers.
tai.kernel @least() {
  tai.parallel_for (%i) in @h {
    %one = arith.constant 1.0 : bf16
    %v = tai.load @h[%i] : bf16
    %r = arith.minnumf %v, %one : bf16
    tai.store %r, @sum[%i] : bf16
  }
  tai.return
}

tai.kernel @ceil() {
  tai.parallel_for (%i) in @h {
    %v = tai.load @h[%i] : bf16
    %r = math.ceil %v : bf16
    tai.store %r, @sum[%i] : bf16
  }
  tai.return
}

tai.kernel @show(%i: index) {
  %h = tai.load @h[%i] : bf16
  %s = tai.load @sum[%i] : bf16
  %a = arith.bitcast %h : bf16 to i16
  %b = arith.bitcast %s : bf16 to i16
  tai.print "{} {}"(%a, %b) : i16, i16
  tai.return
}

func.func private @add(%i: index, %bits: i32) {
  tai.launch @set(%i, %bits) : (index, i32) -> ()
  return
}

func.func @main() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c3 = arith.constant 3 : index
  %c4 = arith.constant 4 : index
  %c5 = arith.constant 5 : index
  %c63 = arith.constant 63 : index
  // The least bf16, and half of it: a tie to even, zero.
  %least = arith.constant 0x00010000 : i32
  // Just below the least normal number: rounds up to it.
  %below = arith.constant 0x007fffff : i32
  // Three quarters between two numbers, and a tie to the odd one's neighbour.
  %up = arith.constant 0x3f80c000 : i32
  %tie = arith.constant 0x3f818000 : i32
  // A NaN whose payload lies in the lower half, and a denormal of f32 alone.
  %nan = arith.constant 0xff800001 : i32
  %small = arith.constant 0x80028000 : i32
  func.call @add(%c0, %least) : (index, i32) -> ()
  func.call @add(%c1, %below) : (index, i32) -> ()
  func.call @add(%c2, %up) : (index, i32) -> ()
  func.call @add(%c3, %tie) : (index, i32) -> ()
  func.call @add(%c4, %nan) : (index, i32) -> ()
  func.call @add(%c5, %small) : (index, i32) -> ()
  func.call @add(%c63, %least) : (index, i32) -> ()
  tai.launch @round() : () -> ()
  tai.launch @halve() : () -> ()
  // CHECK: 1 0
  // CHECK-NEXT: 128 64
  // CHECK-NEXT: 16257 16129
  // CHECK-NEXT: 16258 16130
  // CHECK-NEXT: -64 -64
  // CHECK-NEXT: -32766 -32767
  // CHECK-NEXT: 1 0
  tai.launch @show(%c0) : (index) -> ()
  tai.launch @show(%c1) : (index) -> ()
  tai.launch @show(%c2) : (index) -> ()
  tai.launch @show(%c3) : (index) -> ()
  tai.launch @show(%c4) : (index) -> ()
  tai.launch @show(%c5) : (index) -> ()
  tai.launch @show(%c63) : (index) -> ()
  // CHECK-NEXT: 1 1
  // CHECK-NEXT: -32766 -32766
  tai.launch @least() : () -> ()
  tai.launch @show(%c0) : (index) -> ()
  tai.launch @show(%c5) : (index) -> ()
  // CHECK-NEXT: 1 16256
  // CHECK-NEXT: -32766 -32768
  tai.launch @ceil() : () -> ()
  tai.launch @show(%c0) : (index) -> ()
  tai.launch @show(%c5) : (index) -> ()
  return
}
