// RUN: tai-opt %s --split-input-file --tai-narrow-indices | FileCheck %s
// RUN: tai-opt %s --split-input-file --tai-narrow-indices=remarks 2>&1 \
// RUN:   | FileCheck %s --check-prefix=REMARK

// Values from i32 fit, and so do sums of them that address an
// access.
// CHECK: module attributes {tai.index_bits = 32 : i64}
module {
  tai.tree @t : !tai.root<dense<[i: 64, j: 64], {x: f32}>>
  tai.field @x = @t["x"] : f32, rank 2
  tai.kernel @small(%n: i32) {
    %c0 = arith.constant 0 : index
    %c1 = arith.constant 1 : index
    %c8 = arith.constant 8 : index
    %end = arith.index_cast %n : i32 to index
    tai.parallel_for (%i) = (%c0) to (%end) {
      %next = arith.addi %end, %c1 : index
      scf.for %k = %c0 to %end step %c1 {
        %0 = tai.load @x[%next, %k] : f32
        tai.store %0, @x[%i, %k] : f32
      }
    }
    tai.parallel_for (%i, %j) = (%c0, %c8) to (%c8, %c8) {
      %0 = tai.load @x[%i, %j] : f32
    }
    tai.return
  }
}

// -----

// A bound of 64 bits.
// REMARK:      remark: indices have 64 bits: a value may not fit 32
// REMARK-NEXT: %end = arith.index_cast %n : i64 to index
// CHECK:     module {
module {
  tai.tree @t : !tai.root<dense<[i: 64], {x: f32}>>
  tai.field @x = @t["x"] : f32, rank 1
  tai.kernel @bound(%n: i64) {
    %c0 = arith.constant 0 : index
    %end = arith.index_cast %n : i64 to index
    tai.parallel_for (%i) = (%c0) to (%end) {
      %0 = tai.load @x[%i] : f32
    }
    tai.return
  }
}

// -----

// A bound of 64 bits that a remainder makes small.
// CHECK: module attributes {tai.index_bits = 32 : i64}
module {
  tai.tree @t : !tai.root<dense<[i: 64], {x: f32}>>
  tai.field @x = @t["x"] : f32, rank 1
  tai.kernel @small_bound(%n: i64) {
    %c0 = arith.constant 0 : index
    %c64 = arith.constant 64 : i64
    %rest = arith.remsi %n, %c64 : i64
    %end = arith.index_cast %rest : i64 to index
    tai.parallel_for (%i) = (%c0) to (%end) {
      %0 = tai.load @x[%i] : f32
    }
    tai.return
  }
}

// -----

// A bound of a loop inside.
// CHECK:     module {
module {
  tai.tree @t : !tai.root<dense<[i: 64], {x: f32}>>
  tai.field @x = @t["x"] : f32, rank 1
  tai.kernel @serial(%n: i64) {
    %c0 = arith.constant 0 : index
    %c1 = arith.constant 1 : index
    %end = arith.index_cast %n : i64 to index
    tai.parallel_for (%i) = (%c0) to (%c1) {
      scf.for %k = %c0 to %end step %c1 {
        %0 = tai.load @x[%i] : f32
      }
    }
    tai.return
  }
}

// -----

// A product of indices that is used as a number.
// CHECK:     module {
module {
  tai.tree @t : !tai.root<dense<[i: 64], {x: i64}>>
  tai.field @x = @t["x"] : i64, rank 1
  tai.kernel @product(%n: i32) {
    %c0 = arith.constant 0 : index
    %c64 = arith.constant 64 : index
    %size = arith.index_cast %n : i32 to index
    tai.parallel_for (%i) = (%c0) to (%c64) {
      %0 = arith.muli %i, %size : index
      %1 = arith.index_cast %0 : index to i64
      tai.store %1, @x[%i] : i64
    }
    tai.return
  }
}

// -----

// A sum of indices that is used as a number, too.
// CHECK:     module {
module {
  tai.tree @t : !tai.root<dense<[i: 64], {x: i64}>>
  tai.field @x = @t["x"] : i64, rank 1
  tai.kernel @number(%n: i32) {
    %c0 = arith.constant 0 : index
    %c1 = arith.constant 1 : index
    %at = arith.index_cast %n : i32 to index
    tai.parallel_for (%i) = (%c0) to (%c1) {
      %0 = arith.addi %at, %c1 : index
      %1 = arith.index_cast %0 : index to i64
      tai.store %1, @x[%0] : i64
    }
    tai.return
  }
}

// -----

// Two bounds of 32 bits: the number of iterations may be large.
// REMARK:      remark: indices have 64 bits: the loop may count beyond 32
// REMARK-NEXT: tai.parallel_for (%i, %j)
// CHECK:     module {
module {
  tai.tree @t : !tai.root<dense<[i: 64], {x: f32}>>
  tai.field @x = @t["x"] : f32, rank 1
  tai.kernel @box(%n: i32) {
    %c0 = arith.constant 0 : index
    %end = arith.index_cast %n : i32 to index
    tai.parallel_for (%i, %j) = (%c0, %c0) to (%end, %end) {
      %0 = tai.load @x[%j] : f32
    }
    tai.return
  }
}

// -----

// From a negative i32 to a positive one there may be more than i32 counts.
// CHECK:     module {
module {
  tai.tree @t : !tai.root<dense<[i: 64], {x: f32}>>
  tai.field @x = @t["x"] : f32, rank 1
  tai.kernel @range(%m: i32, %n: i32) {
    %begin = arith.index_cast %m : i32 to index
    %end = arith.index_cast %n : i32 to index
    tai.parallel_for (%i) = (%begin) to (%end) {
      %0 = tai.load @x[%i] : f32
    }
    tai.return
  }
}

// -----

// A counter behind the end of an i32 range is none of i32.
// CHECK:     module {
module {
  tai.tree @t : !tai.root<dense<[i: 64], {x: f32}>>
  tai.field @x = @t["x"] : f32, rank 1
  tai.kernel @step(%n: i32) {
    %c0 = arith.constant 0 : index
    %c1 = arith.constant 1 : index
    %c2 = arith.constant 2 : index
    %end = arith.index_cast %n : i32 to index
    tai.parallel_for (%i) = (%c0) to (%c1) {
      scf.for %k = %c0 to %end step %c2 {
        %0 = tai.load @x[%k] : f32
      }
    }
    tai.return
  }
}

// -----

// A loop that can be left counts up to its end.
// CHECK: module attributes {tai.index_bits = 32 : i64}
module {
  tai.tree @t : !tai.root<dense<[i: 64], {x: f32}>>
  tai.field @x = @t["x"] : f32, rank 1
  tai.kernel @while(%n: i32, %go: i1) {
    %c0 = arith.constant 0 : index
    %c1 = arith.constant 1 : index
    %end = arith.index_cast %n : i32 to index
    tai.parallel_for (%i) = (%c0) to (%c1) {
      %last = scf.while (%k = %c0) : (index) -> index {
        %more = arith.cmpi slt, %k, %end : index
        %on = arith.andi %more, %go : i1
        scf.condition(%on) %k : index
      } do {
      ^bb0(%k: index):
        %0 = tai.load @x[%k] : f32
        %next = arith.addi %k, %c1 : index
        scf.yield %next : index
      }
    }
    tai.return
  }
}

// -----

// One that counts while something else holds may count on.
// CHECK:     module {
module {
  tai.tree @t : !tai.root<dense<[i: 64], {x: f32}>>
  tai.field @x = @t["x"] : f32, rank 1
  tai.kernel @endless(%go: i1) {
    %c0 = arith.constant 0 : index
    %c1 = arith.constant 1 : index
    tai.parallel_for (%i) = (%c0) to (%c1) {
      %last = scf.while (%k = %c0) : (index) -> index {
        scf.condition(%go) %k : index
      } do {
      ^bb0(%k: index):
        %next = arith.addi %k, %c1 : index
        scf.yield %next : index
      }
    }
    tai.return
  }
}

// -----

// A tree beyond 1 GiB.
// REMARK: remark: indices have 64 bits: the tree is larger than 1 GiB
// CHECK:     module {
module {
  tai.tree @t : !tai.root<dense<[i: 300000000], {x: f32}>>
  tai.field @x = @t["x"] : f32, rank 1
  tai.kernel @large() {
    %c0 = arith.constant 0 : index
    %0 = tai.load @x[%c0] : f32
    tai.return
  }
}

// -----

// How large an array is, its launch says.
// CHECK:     module {
module {
  tai.kernel @array(%a: memref<?xf32>) {
    tai.return
  }
}

// -----

// A field whose first index is far from zero.
// CHECK:     module {
module {
  tai.tree @t : !tai.root<dense<[i: 64], {x: f32}>>
  tai.field @x = @t["x"] : f32, rank 1, offset [1073741824]
  tai.kernel @far(%n: i32) {
    %c0 = arith.constant 0 : index
    %0 = tai.load @x[%c0] : f32
    tai.return
  }
}

// -----

// Constants that do not fit.
// CHECK:     module {
module {
  tai.kernel @constant() {
    %c0 = arith.constant 4294967296 : index
    %c1 = arith.constant 4294967297 : index
    tai.parallel_for (%i) = (%c0) to (%c1) {
    }
    tai.return
  }
}

// -----

// A negative index without its sign differs in 64 and 32 bits: -2 is 14 modulo
// 18 in 64 bits, and 2 in 32.
// REMARK:    %rest = arith.remui
// CHECK:     module {
module {
  tai.tree @t : !tai.root<dense<[i: 18], {x: f32}>>
  tai.field @x = @t["x"] : f32, rank 1
  tai.kernel @without_sign() {
    %c18 = arith.constant 18 : index
    %c2 = arith.constant 2 : index
    tai.parallel_for (%i) in @x {
      %back = arith.subi %i, %c2 : index
      %rest = arith.remui %back, %c18 : index
      %0 = tai.load @x[%rest] : f32
    }
    tai.return
  }
}

// -----

// The same for shifts, and for casts to more than 32 bits.
// REMARK:    %half = arith.shrui
// REMARK:    %0 = arith.index_castui
// CHECK:     module {
module {
  tai.tree @t : !tai.root<dense<[i: 18], {x: f32}>>
  tai.field @x = @t["x"] : f32, rank 1
  tai.kernel @shift() {
    %c60 = arith.constant 60 : index
    %c2 = arith.constant 2 : index
    tai.parallel_for (%i) in @x {
      %back = arith.subi %i, %c2 : index
      %half = arith.shrui %back, %c60 : index
      %0 = tai.load @x[%half] : f32
    }
    tai.return
  }
}

// -----

// CHECK:     module {
module {
  tai.tree @t : !tai.root<dense<[i: 18], {x: i64}>>
  tai.field @x = @t["x"] : i64, rank 1
  tai.kernel @cast() {
    %c2 = arith.constant 2 : index
    tai.parallel_for (%i) in @x {
      %back = arith.subi %i, %c2 : index
      %0 = arith.index_castui %back : index to i64
      tai.store %0, @x[%i] : i64
    }
    tai.return
  }
}

// -----

// An index that is not negative is the same with and without a sign.
// CHECK: module attributes {tai.index_bits = 32 : i64}
module {
  tai.tree @t : !tai.root<dense<[i: 18], {x: f32}>>
  tai.field @x = @t["x"] : f32, rank 1
  tai.kernel @positive() {
    %c5 = arith.constant 5 : index
    tai.parallel_for (%i) in @x {
      %rest = arith.remui %i, %c5 : index
      %0 = tai.load @x[%rest] : f32
    }
    tai.return
  }
}

// -----

// A module without kernels is not marked.
// CHECK: module attributes {foo.bar} {
// CHECK-NEXT: func.func @alone
module attributes {foo.bar} {
  func.func @alone(%a: index) -> index {
    return %a : index
  }
}
