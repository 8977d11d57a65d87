// RUN: tai-run %s --print-field=@y --no-cache | FileCheck %s
// RUN: tai-run %s --print-field=@y --no-cache --opt-level=0 | FileCheck %s
// RUN: tai-run %s --print-field=@y --interpret | FileCheck %s

// A switch looks at all bits of an index and of its cases: 2^32 is not 0, and
// 5 is not 2^32 + 5.
// CHECK: @y : 6xi32 = [1, -1, 2, -1, -1, 3]

tai.tree @t : !tai.root<dense<[i: 6], {x: i64, y: i32}>>
tai.field @x = @t["x"] : i64, rank 1
tai.field @y = @t["y"] : i32, rank 1

tai.kernel @choose() {
  tai.parallel_for (%i) in @x {
    %x = tai.load @x[%i] : i64
    %at = arith.index_cast %x : i64 to index
    %r = scf.index_switch %at -> i32
    case 0 {
      %c = arith.constant 1 : i32
      scf.yield %c : i32
    }
    case 4294967301 {
      %c = arith.constant 2 : i32
      scf.yield %c : i32
    }
    case -1 {
      %c = arith.constant 3 : i32
      scf.yield %c : i32
    }
    default {
      %c = arith.constant -1 : i32
      scf.yield %c : i32
    }
    tai.store %r, @y[%i] : i32
  }
  tai.return
}

func.func private @set(%i: index, %value: i64) {
  tai.store %value, @x[%i] : i64
  return
}

func.func @main() {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %c2 = arith.constant 2 : index
  %c3 = arith.constant 3 : index
  %c4 = arith.constant 4 : index
  %c5 = arith.constant 5 : index
  %zero = arith.constant 0 : i64
  %wraps = arith.constant 4294967296 : i64
  %large = arith.constant 4294967301 : i64
  %five = arith.constant 5 : i64
  %least = arith.constant -9223372036854775808 : i64
  %minus = arith.constant -1 : i64
  call @set(%c0, %zero) : (index, i64) -> ()
  call @set(%c1, %wraps) : (index, i64) -> ()
  call @set(%c2, %large) : (index, i64) -> ()
  call @set(%c3, %five) : (index, i64) -> ()
  call @set(%c4, %least) : (index, i64) -> ()
  call @set(%c5, %minus) : (index, i64) -> ()
  tai.launch @choose() : () -> ()
  return
}
