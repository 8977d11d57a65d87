// RUN: tai-run %s --no-cache --print-field=@sum | FileCheck %s
// RUN: env TAI_CUDA_EMULATION=1 tai-run %s --no-cache --arch=cuda --print-field=@sum | FileCheck %s
// RUN: tai-run %s --interpret --print-field=@sum | FileCheck %s

// An element is written, then once more under a condition, and its neighbours
// after that. Stores to neighbours are joined where the last of them stands,
// which must not move the first store behind the conditional one.
// CHECK: @sum : 64xi32 = [-2147483645, -2147483647, -2147483647, -2147483645,
tai.tree @u : !tai.root<dense<[i: 64], {flag: i1}>>
tai.tree @t : !tai.root<dense<[i: 64], {sum: i32, pair: vector<2xi32>}>>
tai.field @flag = @u["flag"] : i1, rank 1
tai.field @sum = @t["sum"] : i32, rank 1
tai.field @pair = @t["pair"] : vector<2xi32>, rank 1
tai.kernel @init() {
  tai.parallel_for (%i) in @flag {
    %c3 = arith.constant 3 : index
    %c0 = arith.constant 0 : index
    %r = arith.remui %i, %c3 : index
    %b = arith.cmpi eq, %r, %c0 : index
    tai.store %b, @flag[%i] : i1
  }
  tai.return
}
tai.kernel @k() {
  %c0 = arith.constant 0 : index
  %c64 = arith.constant 64 : index
  %c2 = arith.constant 2 : index
  %m2 = arith.constant -2 : i64
  %z = arith.constant 0 : i64
  %one = arith.constant 1 : i64
  %M = arith.constant 2147483647 : i32
  %v31 = arith.constant dense<31> : vector<2xi32>
  %vM = arith.constant dense<2147483647> : vector<2xi32>
  tai.parallel_for (%i) = (%c0) to (%c64) serialize {
    %c = tai.load @flag[%i] : i1
    %old = tai.atomic sub %M, @sum[%i] : i32
    scf.for %k = %m2 to %z step %one : i64 {
      scf.if %c {
        tai.store %v31, @pair[%i] : vector<2xi32>
        %a = tai.atomic sub %M, @sum[%i] : i32
      } else {
        %r = arith.remui %i, %c2 : index
        %w = vector.insert %old, %vM [%r] : i32 into vector<2xi32>
        tai.store %w, @pair[%i] : vector<2xi32>
      }
    }
  }
  tai.return
}
func.func @main() {
  tai.launch @init() : () -> ()
  tai.launch @k() : () -> ()
  return
}
