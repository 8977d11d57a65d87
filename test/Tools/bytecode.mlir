// Written bytecode is read back, by the tools and as programs do.
// RUN: tai-translate --tai-to-bytecode %s -o %t.bc
// RUN: tai-translate --tai-from-bytecode %t.bc | FileCheck %s
// RUN: tai-run %t.bc --print-field=@x | FileCheck %s --check-prefix=RAN

// CHECK: tai.kernel @main_kernel
// RAN: @x : 2xf32 = [3, 3]

// Without its checksum programs refuse it, and the tools read it.
// RUN: tai-opt %s --emit-bytecode -o %t.raw
// RUN: not tai-translate --tai-from-bytecode %t.raw 2>&1 | FileCheck %s --check-prefix=RAW
// RUN: tai-opt %t.raw | FileCheck %s
// RUN: tai-run %t.raw --print-field=@x | FileCheck %s --check-prefix=RAN
// RAW: bytecode.mlir.tmp.raw:1:1: error: this is MLIR bytecode without a checksum
// RAW: note: give the module as text, or as what 'tai-translate --tai-to-bytecode' or taiModuleWrite makes of it

// Damage is seen.
// RUN: %python -c "import sys; b = bytearray(open(sys.argv[1], 'rb').read()); b[len(b) // 2] ^= 1; open(sys.argv[2], 'wb').write(b)" %t.bc %t.bad
// RUN: not tai-translate --tai-from-bytecode %t.bad 2>&1 | FileCheck %s --check-prefix=BAD
// RUN: not tai-run %t.bad 2>&1 | FileCheck %s --check-prefix=BAD
// BAD: bytecode.mlir.tmp.bad:1:1: error: this bytecode is damaged: its checksum does not match

tai.tree @t : !tai.root<dense<[i: 2], {x: f32}>>
tai.field @x = @t["x"] : f32, rank 1

tai.kernel @main_kernel() {
  %three = arith.constant 3.0 : f32
  tai.parallel_for (%i) in @x {
    tai.store %three, @x[%i] : f32
  }
  tai.return
}

func.func @main() {
  tai.launch @main_kernel() : () -> ()
  return
}
